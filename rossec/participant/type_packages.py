"""Which package has the definition of a message or service type: what to install. Pure.

Debian has the definitions of a ROS package in one of its own, and ROS's packages for Ubuntu have
everything of a ROS package in one. For hints alone.
"""

from collections.abc import Iterable
from typing import Final

from ca.suggestions import closest

_IN_ROS: Final = frozenset({
    "actionlib_msgs", "diagnostic_msgs", "geometry_msgs", "map_msgs", "move_base_msgs", "nav_msgs",
    "pcl_msgs", "rosgraph_msgs", "sensor_msgs", "shape_msgs", "std_msgs", "std_srvs", "stereo_msgs",
    "tf2_msgs", "trajectory_msgs", "visualization_msgs",
})  # fmt: skip
"""Of these Debian has the definitions in `ros-...`."""
_OTHERS: Final = {
    "actionlib": "libactionlib-dev", "bond": "libbond-dev", "nodelet": "libnodelet-dev",
    "roscpp": "ros-roscpp-msg", "topic_tools": "ros-topic-tools-srvs",
}  # fmt: skip


def what_to_install(type_name: str) -> str:
    """What brings the definition of a type to a host."""
    package = type_name.partition("/")[0]
    ours = f"of ROS for Ubuntu: ros-noetic-{_dashed(package)}"
    if (theirs := _debian(package)) is not None:
        return f"it is in Debian's package {theirs} ({ours}): apt install {theirs}"
    return (
        f"Debian does not have it ({ours}); of a workspace: name the folder of {package} in"
        " ROS_PACKAGE_PATH"
    )


def unknown_type(type_name: str, known: Iterable[str]) -> str:
    """The hint where a message type is not known: one of that package, or what to install."""
    package, _, leaf = type_name.partition("/")
    pairs = (name.partition("/") for name in known)
    same = [each for its, _, each in pairs if its == package]
    if same:
        near = closest(leaf, same)
        meant = f"did you mean {package}/{near}? " if near is not None else ""
        return f"{meant}it is none of {package} as it is known here; {_own(package)}"
    near = None if _debian(package) is not None else closest(type_name, known)
    if near is not None:
        return f"did you mean {near}? else {what_to_install(type_name)}"
    return what_to_install(type_name)


def _own(package: str) -> str:
    return f"one of your own: register_type(), or the folder of its {package} in ROS_PACKAGE_PATH"


def _debian(package: str) -> str | None:
    return f"ros-{_dashed(package)}" if package in _IN_ROS else _OTHERS.get(package)


def _dashed(package: str) -> str:
    return package.replace("_", "-").lower()
