"""Which package has the definition of a type."""

import pytest

from rossec.errors import MessageError
from rossec.node import message_type, service_type
from rossec.participant.definitions import unknown_type, what_to_install

KNOWN = ["geometry_msgs/Pose", "geometry_msgs/PoseStamped", "sensor_msgs/LaserScan"]


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("map_msgs/OccupancyGridUpdate", "ros-map-msgs"),
        ("move_base_msgs/MoveBaseAction", "ros-move-base-msgs"),
        ("bond/Status", "libbond-dev"),
    ],
)
def test_debian_has_it(name: str, package: str) -> None:
    said = what_to_install(name)
    assert f"Debian's package {package} " in said
    assert said.endswith(f"apt install {package}")
    assert "ros-noetic-" in said


def test_debian_does_not_have_it() -> None:
    said = what_to_install("velodyne_msgs/VelodyneScan")
    assert said.startswith("Debian does not have it (of ROS for Ubuntu: ros-noetic-velodyne-msgs)")
    assert "the folder of velodyne_msgs in ROS_PACKAGE_PATH" in said


def test_what_was_meant() -> None:
    assert unknown_type("geometry_msgs/PoseStampd", KNOWN).startswith(
        "did you mean geometry_msgs/PoseStamped? it is none of geometry_msgs"
    )
    assert unknown_type("geometry_msgs/Quux", KNOWN).startswith("it is none of geometry_msgs")
    assert unknown_type("sensor_msg/LaserScan", KNOWN).startswith(
        "did you mean sensor_msgs/LaserScan? else Debian does not have it"
    )
    assert unknown_type("map_msgs/ProjectedMap", ["x/Y"]).startswith("it is in Debian's package")


def test_who_names_an_unknown_type_is_told_so() -> None:
    with pytest.raises(MessageError) as caught:
        message_type("map_msgs/ProjectedMap")
    assert caught.value.hint.endswith("apt install ros-map-msgs")
    with pytest.raises(MessageError) as caught:
        service_type("topic_tools/MuxSelect")
    assert "apt install ros-topic-tools-srvs; then add it with register_service_type()" in (caught.value.hint)
