"""An older version of rossec, made from the history of this repository, without network.

It is installed as a person installs a version beside another: a virtual environment of its own,
with the same libraries.
"""

import subprocess
import sys
import sysconfig
import venv
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
_PROGRAM: Final = """#!{python}
import sys
from rossec.__main__ import main
sys.exit(main())
"""


def install_version(commit: str, place: Path, sources: Path) -> None:
    """Make a virtual environment at `place` that has rossec of `commit`, unpacked in `sources`.

    Without the history the test is skipped: what it says of an upgrade is then not shown.
    """
    command = ("git", "-C", str(ROOT), "archive", commit, "rossec", "ca", "grants")
    made = subprocess.run(command, capture_output=True, check=False)
    if made.returncode:
        pytest.skip(f"NOT RUN: the history of {commit} is not here: {made.stderr.decode()}")
    sources.mkdir()
    subprocess.run(("tar", "-x", "-C", str(sources)), input=made.stdout, check=True)
    venv.create(place, system_site_packages=True, symlinks=True)
    python = place / "bin" / "python"
    [packages] = place.glob("lib/python3*/site-packages")
    # A line of such a file is searched in this order; its own .pth files are not read.
    (packages / "version.pth").write_text(f"{sources}\n{sysconfig.get_path('purelib')}\n")
    program = place / "bin" / "rossec"
    program.write_text(_PROGRAM.format(python=python))
    program.chmod(0o755)
    found = subprocess.run(
        (str(python), "-I", "-c", "import rossec; print(rossec.__file__)"),
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(found.stdout).is_relative_to(sources), (sys.version, found.stdout)
