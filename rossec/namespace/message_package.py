"""The ROS package that describes the type of `/get_topic_name`: for catkin, or for genpy alone.

The fields are the thesis's (appendix A): programs that were written for its `GetTopicName` call
this service, since ROS compares md5sums.
"""

from importlib.resources import files as resources
from pathlib import Path
from typing import Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.participant.service_types import ServiceType, register_service_type

PACKAGE: Final = "rossec_namespace"
TYPE: Final = f"{PACKAGE}/GetTopicName"
_SRV: Final = "srv/GetTopicName.srv"
_FILES: Final = ("package.xml", "CMakeLists.txt", _SRV)
_MODE: Final = 0o644


def service_type() -> ServiceType:
    """The type, registered in this process."""
    return register_service_type(TYPE, _text(_SRV))


def write(directory: Path) -> Path:
    """Write the package into `directory`, as a folder of its name; returns that.

    Raises:
        ConfigurationError: there is one already.
        NotWritten: the disk refused it.
    """
    package = directory / PACKAGE
    if package.exists():
        raise ConfigurationError(f"{package} exists and is not overwritten", "remove it first")
    (package / "srv").mkdir(parents=True)
    for name in _FILES:
        files.create(package / name, _text(name).encode(), _MODE)
    return package


def _text(name: str) -> str:
    return resources("rossec.namespace").joinpath(PACKAGE, *name.split("/")).read_text()
