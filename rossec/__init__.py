"""The running system: secure channel, ROS wire, master, node, command line.

`ca` and `grants` are generic names, and ROS machines set PYTHONPATH, which comes before
site-packages: a stranger's `ca` would be our trust root. So the siblings must lie beside this
package, and that is checked before either is imported (docs/decisions/0002).
"""

import sys as _sys
from importlib.util import find_spec as _find_spec
from pathlib import Path as _Path


def _check_siblings() -> None:
    home = _Path(__file__).resolve().parent.parent
    for name in ("ca", "grants"):
        spec = _find_spec(name)
        origin = spec.origin if spec is not None else None
        if origin is None or _Path(origin).resolve().parent != home / name:
            # Nothing of ours may be imported yet, not even the error tree.
            _sys.exit(
                f"rossec: error: a foreign package {name!r} ({origin}) hides the one of rossec\n"
                f"rossec: hint: remove its folder from PYTHONPATH, or start with"
                f" `python -I -m rossec`"
            )


_check_siblings()
