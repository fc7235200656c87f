"""A type described by what its fields are, at any depth."""

from grants.filters.layout import Layout, parse
from grants.vocabulary.contents import Content, DataWord, Description, describe
from tests.grants.messages import SEPARATOR
from tests.grants.vocabulary.layouts import layout_of

OWN = f"""Header header
Seat[] seats
geometry_msgs/Point at
string who
{SEPARATOR}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{SEPARATOR}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{SEPARATOR}
MSG: acme_msgs/Seat
bool taken
geometry_msgs/Point[] legs
"""
LAYOUT: Layout = parse("acme_msgs/Table", OWN)


def by_path(found: Description) -> dict[str, Content]:
    return {field.path: field.content for field in found.fields}


def paths(name: str, word: DataWord, how: str = "relatives") -> set[str]:
    return {field.path for field in getattr(describe(layout_of(name)), how)(word)}


def test_a_nested_type_is_described_by_its_own_table() -> None:
    found = by_path(describe(layout_of("nav_msgs/Odometry")))
    assert found["pose.pose.position.x"] is Content.COORDINATE
    assert found["pose.pose.orientation.w"] is Content.HEADING
    assert found["pose.covariance"] is Content.UNCERTAINTY
    assert found["twist.twist.linear.x"] is Content.VELOCITY
    assert found["header.stamp"] is Content.TIME
    assert found["child_frame_id"] is Content.CHILD_FRAME


def test_a_named_field_has_its_content_throughout() -> None:
    found = by_path(describe(layout_of("geometry_msgs/Transform")))
    assert found["translation.x"] is Content.COORDINATE  # not the bare x of a Vector3
    assert by_path(describe(layout_of("nav_msgs/OccupancyGrid")))["info.origin.position.x"] is (Content.MAP)


def test_elements_of_arrays_name_the_outermost_array() -> None:
    found = {field.path: field.array for field in describe(LAYOUT).fields}
    assert found["seats[*].legs[*].x"] == "seats"
    assert found["seats[*].taken"] == "seats"
    assert found["at.x"] == ""


def test_what_no_table_has_is_unknown_and_the_rest_is_not() -> None:
    found = describe(LAYOUT)
    assert found.unknown == ("seats[*].taken", "who")
    assert by_path(found)["at.x"] is Content.COORDINATE


def test_a_policy_says_what_its_own_types_contain() -> None:
    own = {"acme_msgs/Table": {"who": Content.NAME}, "acme_msgs/Seat": {"taken": Content.READING}}
    found = describe(LAYOUT, own)
    assert found.unknown == ()
    assert found.words == (DataWord.POSITION, DataWord.IDENTITY, DataWord.HOME)


def test_a_path_within_an_own_type_may_be_named_from_above() -> None:
    own = {"acme_msgs/Table": {"who": Content.NAME, "seats.taken": Content.READING}}
    assert describe(LAYOUT, own).unknown == ()


def test_a_lamp_of_the_home_is_not_carried_about() -> None:
    """What a policy says of a bare value keeps its meaning: `home` is not the position."""
    for content in (Content.TEMPERATURE, Content.BRIGHTNESS, Content.READING):
        found = describe(layout_of("std_msgs/Float64"), here={"data": content})
        assert not found.tells(DataWord.POSITION)


def test_only_names_that_can_be_pseudonyms_are_names() -> None:
    assert describe(layout_of("diagnostic_msgs/DiagnosticArray")).has_names
    assert describe(layout_of("actionlib_msgs/GoalID")).has_names
    assert not describe(layout_of("nav_msgs/Odometry")).has_names


def test_a_topic_says_what_its_bare_value_is() -> None:
    found = describe(layout_of("std_msgs/Float64"), here={"data": Content.TEMPERATURE})
    assert (found.unknown, found.words) == ((), (DataWord.HOME,))
    assert describe(layout_of("std_msgs/Float64")).unknown == ("data",)


def test_what_gives_a_position_away_in_the_same_message() -> None:
    found = paths("nav_msgs/Odometry", DataWord.POSITION)
    assert {"twist.twist.linear.x", "pose.pose.orientation.z"} <= found
    assert "header.stamp" not in found
    assert "pose.pose.position.x" not in found


def test_what_gives_a_position_away_on_a_topic_of_its_own() -> None:
    assert "linear.x" in paths("geometry_msgs/Twist", DataWord.POSITION)
    assert "position" in paths("sensor_msgs/JointState", DataWord.POSITION)
    assert "ranges" in paths("sensor_msgs/LaserScan", DataWord.POSITION, "carrying")
    assert paths("sensor_msgs/Temperature", DataWord.POSITION) == {"temperature", "variance"}
    assert "current" in paths("sensor_msgs/BatteryState", DataWord.POSITION)
    assert paths("sensor_msgs/TimeReference", DataWord.POSITION) == set()
    assert paths("sensor_msgs/Image", DataWord.POSITION, "hints") == {"data"}


def test_times_are_told_apart() -> None:
    found = describe(layout_of("geometry_msgs/PoseStamped"))
    assert [field.path for field in found.times] == ["header.seq", "header.stamp"]


def test_the_words_are_those_of_the_content_not_of_its_relatives() -> None:
    assert describe(layout_of("geometry_msgs/Twist")).words == (DataWord.MOVEMENT,)
    assert describe(layout_of("sensor_msgs/Image")).words == (DataWord.IMAGE,)
    assert describe(layout_of("std_msgs/Empty")).words == ()


def test_a_level_concerns_a_type_that_tells_the_word_in_any_way() -> None:
    def told(name: str) -> set[DataWord]:
        return {word for word in DataWord if describe(layout_of(name)).tells(word)}

    assert told("geometry_msgs/Twist") == {DataWord.MOVEMENT, DataWord.POSITION, DataWord.PRESENCE}
    assert told("sensor_msgs/Temperature") == set(DataWord) - {DataWord.IMAGE, DataWord.SOUND}
    assert told("sensor_msgs/TimeReference") == {DataWord.IDENTITY, DataWord.PRESENCE}
    assert DataWord.POSITION in told("sensor_msgs/Image")
    assert told("std_msgs/Empty") == {DataWord.PRESENCE}
