"""Compiles C++ programs against Debian's roscpp, once for all runs."""

import hashlib
import shlex
import subprocess
from pathlib import Path
from typing import Final

_PROBE: Final = Path(__file__).with_name("probe.cpp")
_NODELET: Final = Path(__file__).with_name("shout.cpp")
# Debian's packages of these have no pkg-config file.
_PLUGINS: Final = (
    *(f"-I/usr/include/{name}" for name in ("pluginlib", "class_loader", "rcpputils", "rcutils")),
    "-lclass_loader",
    "-lnodeletlib",
)


def compiled(directory: Path, source: Path = _PROBE) -> Path:
    """The program of `source`; cached in `directory` until the source changes."""
    return _compiled(source, directory)


def nodelet(directory: Path, package: Path) -> Path:
    """The ROS package `shout`, made in `package`, with the nodelet of `shout.cpp`."""
    library = _compiled(_NODELET, directory, "-shared", "-fPIC", *_PLUGINS)
    package.mkdir(parents=True)
    (package / "libshout.so").symlink_to(library)
    (package / "package.xml").write_text(
        "<package><name>shout</name><run_depend>nodelet</run_depend>"
        '<export><nodelet plugin="${prefix}/nodelets.xml"/></export></package>'
    )
    (package / "nodelets.xml").write_text(
        '<library path="libshout"><class name="shout/Shout" type="shout::Shout"'
        ' base_class_type="nodelet::Nodelet"/></library>'
    )
    return package


def _compiled(source: Path, directory: Path, *options: str) -> Path:
    digest = hashlib.sha256(source.read_bytes() + shlex.join(options).encode()).hexdigest()[:16]
    program = directory / f"{source.stem}-{digest}"
    if not program.exists():
        flags = subprocess.run(
            ["pkg-config", "--cflags", "--libs", "roscpp", "std_msgs"],
            check=True,
            capture_output=True,
            text=True,
        )
        unfinished = program.with_suffix(".new")
        command = ("g++", "-O1", str(source), "-o", str(unfinished))
        subprocess.run([*command, *shlex.split(flags.stdout), *options], check=True, capture_output=True)
        unfinished.rename(program)
    return program
