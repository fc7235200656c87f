"""The type of `/get_topic_name` as Debian's genpy generates it from the package description."""

import subprocess
from pathlib import Path
from typing import Final

from rossec.namespace.topic_names import PACKAGE, write

GENSRV: Final = "/usr/lib/genpy/gensrv_py.py"


def generated(directory: Path) -> Path:
    """Write the package into `directory`, with its Python modules: a path to import from."""
    package = write(directory)
    srv = package / "srv"
    for arguments in (
        ("-p", PACKAGE, "-o", str(srv), str(srv / "GetTopicName.srv")),
        ("--initpy", "-p", PACKAGE, "-o", str(srv)),
    ):
        subprocess.run(["/usr/bin/python3", GENSRV, *arguments], check=True, timeout=60)
    (package / "__init__.py").touch()
    return directory
