"""Compiles `probe.cpp` against Debian's roscpp, once for all runs."""

import hashlib
import shlex
import subprocess
from pathlib import Path
from typing import Final

_SOURCE: Final = Path(__file__).with_name("probe.cpp")


def compiled(directory: Path) -> Path:
    """The program; `directory` keeps it until its source changes."""
    program = directory / f"probe-{hashlib.sha256(_SOURCE.read_bytes()).hexdigest()[:16]}"
    if not program.exists():
        flags = subprocess.run(
            ["pkg-config", "--cflags", "--libs", "roscpp", "std_msgs"],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        unfinished = program.with_suffix(".new")
        subprocess.run(
            ["g++", "-O1", str(_SOURCE), "-o", str(unfinished), *shlex.split(flags.stdout)],
            check=True, capture_output=True,
        )  # fmt: skip
        unfinished.rename(program)
    return program
