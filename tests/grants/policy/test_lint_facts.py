"""What fields show: by the vocabulary, by names where it knows nothing, by names of topics."""

import pytest

from grants.filters.layout import parse
from grants.policy.lint_views import Aspect, aspects, conventional, is_known
from grants.vocabulary.contents import describe
from tests.grants.policy.lint_cases import TYPES, layout_of

OWN = "float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nstring x_name\nfloat32[] lat"


@pytest.mark.parametrize(
    ("kind", "path", "aspect"),
    [
        ("nav_msgs/Odometry", "pose.pose.position.x", Aspect.POSITION),
        ("nav_msgs/Odometry", "pose.pose.orientation.w", Aspect.HEADING),
        ("nav_msgs/Odometry", "pose.covariance", Aspect.COVARIANCE),
        ("nav_msgs/Odometry", "twist.twist.linear.x", Aspect.MOVEMENT),
        ("nav_msgs/Odometry", "twist.covariance", Aspect.MOVEMENT),
        ("nav_msgs/Odometry", "header.stamp", Aspect.TIME),
        ("nav_msgs/Odometry", "header.seq", Aspect.COUNT),
        ("nav_msgs/Path", "poses[*].pose.position.x", Aspect.POSITION),
        ("sensor_msgs/NavSatFix", "latitude", Aspect.POSITION),
        ("sensor_msgs/NavSatFix", "position_covariance", Aspect.COVARIANCE),
        ("sensor_msgs/LaserScan", "ranges", Aspect.SURROUNDINGS),
        ("sensor_msgs/PointCloud2", "data", Aspect.SURROUNDINGS),
        ("sensor_msgs/Image", "data", Aspect.IMAGE),
        ("sensor_msgs/JointState", "position", Aspect.JOINT),
        ("sensor_msgs/JointState", "velocity", Aspect.JOINT_RATE),
        ("diagnostic_msgs/DiagnosticArray", "status[*].hardware_id", Aspect.NAME),
    ],
)
def test_what_a_field_shows(kind: str, path: str, aspect: Aspect) -> None:
    assert aspects(describe(layout_of(kind)))[path] is aspect


@pytest.mark.parametrize(
    ("kind", "path"),
    [
        ("nav_msgs/Odometry", "header.frame_id"),
        ("sensor_msgs/NavSatFix", "status.status"),
        ("sensor_msgs/PointCloud2", "width"),
        ("std_msgs/String", "data"),
    ],
)
def test_what_shows_nothing(kind: str, path: str) -> None:
    assert path not in aspects(describe(layout_of(kind)))


def test_only_a_local_map_shows_where_the_robot_is() -> None:
    layout = describe(layout_of("nav_msgs/OccupancyGrid"))
    assert aspects(layout, "/map")["data"] is Aspect.PLAN
    assert aspects(layout, "/local_costmap/costmap")["data"] is Aspect.SURROUNDINGS


def test_numbers_of_other_packages_by_their_names() -> None:
    assert aspects(describe(parse("own/Place", OWN))) == {
        "x": Aspect.POSITION,
        "y": Aspect.POSITION,
        "theta": Aspect.HEADING,
        "linear_velocity": Aspect.MOVEMENT,
    }


def test_what_is_known() -> None:
    assert is_known(describe(parse("own/Place", OWN)))
    assert all(is_known(describe(layout_of(kind))) for kind in TYPES.values())
    assert not is_known(describe(parse("own/Odd", "float32 a\nstring b")))


@pytest.mark.parametrize(
    ("topic", "aspect"),
    [
        ("/tf", Aspect.POSITION),
        ("/robot/odom", Aspect.POSITION),
        ("/cmd_vel", Aspect.MOVEMENT),
        ("/camera/**", Aspect.IMAGE),
        ("/*/scan", Aspect.SURROUNDINGS),
        ("/clock", Aspect.NOTHING),
        ("/joint_states", Aspect.JOINT),
    ],
)
def test_what_the_name_of_a_topic_says(topic: str, aspect: Aspect) -> None:
    assert conventional(topic) is aspect


def test_a_name_that_says_nothing() -> None:
    assert conventional("/odometer") is None
    assert conventional("/**") is None
