"""The running system: secure channel, ROS wire, master, node, command line.

`ca` and `grants` are generic names, and ROS machines set PYTHONPATH, which comes before
site-packages: a foreign `ca` would be our trust root. So the siblings must lie beside this
package, and that is checked before either is imported (docs/decisions/0002).

`rossec.secure()` secures a rospy program, `rossec.ask()` requests a right for it; until one of them
is used, nothing else is imported.
"""

import sys as _sys
from importlib import import_module as _import_module
from importlib.util import find_spec as _find_spec
from pathlib import Path as _Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rossec.inprocess import ask as ask
    from rossec.inprocess.secure import secure as secure


# `rossec --version` reads it here: importlib.metadata takes as long to import as all of click.
__version__ = "0.1.0"


def _check_python() -> None:
    if _sys.version_info < (3, 11):  # noqa: UP036 - it is imported where pip never was asked
        version = ".".join(map(str, _sys.version_info[:2]))
        _sys.exit(
            "rossec: error: Python 3.11 or newer is needed, and this is Python " + version + "\n"
            "rossec: hint: run this program unmodified behind a sidecar, which has a Python of its"
            " own: docs/howto/unmodified-programs.md"
        )


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


_check_python()
_check_siblings()

_PUBLIC = {"ask": "rossec.inprocess.request", "secure": "rossec.inprocess.secure"}


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'rossec' has no attribute {name!r}")
    return getattr(_import_module(_PUBLIC[name]), name)
