"""What rules of any origin let through, in words."""

import math

import pytest

from grants.filters.compile import preset
from grants.model import Restriction, filter_rules
from grants.vocabulary.assess import Seen, assess
from grants.vocabulary.contents import EXACT, LEVELS, NO, DataWord, describe
from grants.vocabulary.levels import resolve
from tests.grants.vocabulary.layouts import STANDARD, layout_of

ODOMETRY = "nav_msgs/Odometry"
POSE = "geometry_msgs/PoseStamped"
CLEAR: dict[str, object] = {"clear": True}
P, M = DataWord.POSITION, DataWord.MOVEMENT
TYPES = [name for name in STANDARD if not describe(layout_of(name)).unknown]


def seen(name: str, rate: float | None = None, **rules: object) -> dict[DataWord, Seen]:
    paths = {path.replace("__", "."): rule for path, rule in rules.items()}
    given = [Restriction(name, (), filter_rules(paths))] if paths else []
    return assess(describe(layout_of(name)), given, rate)


def rounded(step: float, hysteresis: float | None = None) -> dict[str, object]:
    return {"round": {"step": step} | ({"hysteresis": hysteresis} if hysteresis else {})}


@pytest.mark.parametrize("word", DataWord)
def test_a_level_is_seen_as_itself_or_a_coarser_one(word: DataWord) -> None:
    checked = 0
    for name in TYPES:
        layout = layout_of(name)
        description = describe(layout)
        for level in LEVELS[word][1:] if description.tells(word) else ():
            found = resolve(layout, description, {word: level})
            given = [Restriction(name, (), found.rules, slot=found.slot)] if found.rules or found.slot else []
            one = assess(description, given, found.rate, [word])[word]
            assert one.is_no_finer_than(level), (name, level, one)
            checked += 1
    assert checked or word is DataWord.SOUND  # no standard type carries it


def test_without_rules_everything_is_exact_and_open() -> None:
    found = seen(ODOMETRY)
    assert list(found) == [P, M]
    assert {one.level for one in found.values()} == {EXACT}
    assert "twist.twist.linear.x" in found[P].open


def test_a_position_between_two_levels_has_a_size() -> None:
    found = seen(
        ODOMETRY,
        0.2,
        pose__pose__position=rounded(2, 0.5),
        pose__pose__orientation=CLEAR,
        pose__covariance=CLEAR,
        twist=CLEAR,
    )
    assert (found[P].level, found[P].size, found[P].open) == (EXACT, 2.0, ())
    assert found[P].is_no_finer_than(2)
    assert not found[P].is_no_finer_than(2.1)
    assert not found[P].is_no_finer_than("room")
    assert found[M].by == (P,)
    assert found[P].by == ()


def test_one_open_relative_makes_a_position_exact() -> None:
    found = seen(POSE, 1 / 30, pose__position=rounded(4, 2))
    assert (found[P].level, found[P].size) == (EXACT, 0.0)
    assert found[P].open == tuple(f"pose.orientation.{axis}" for axis in "xyzw")
    assert not found[P].is_no_finer_than(0.01)


@pytest.mark.parametrize(
    ("rate", "hysteresis", "level"),
    [(1 / 30, 2.0, "room"), (None, 2.0, EXACT), (1.0, 2.0, EXACT), (1 / 30, None, EXACT)],
)
def test_a_room_needs_its_rate_and_its_hysteresis(
    rate: float | None, hysteresis: float | None, level: str
) -> None:
    found = seen(POSE, rate, pose__position=rounded(4, hysteresis), pose__orientation=CLEAR)
    assert (found[P].level, found[P].size) == (level, 4.0)


def test_a_wider_step_is_at_least_the_level() -> None:
    found = seen(POSE, 0.001, pose__position=rounded(7, 5), pose__orientation=CLEAR)
    assert (found[P].level, found[P].size) == ("room", 7.0)


def test_one_axis_as_it_is_makes_all_exact() -> None:
    found = seen(
        POSE,
        1 / 30,
        pose__position__x=rounded(4, 2),
        pose__position__y=rounded(4, 2),
        pose__orientation=CLEAR,
    )
    assert found[P].open == ("pose.position.z",)


def test_what_is_hidden_is_so_at_any_rate() -> None:
    found = seen(POSE, pose=CLEAR)
    assert (found[P].level, found[P].size) == (NO, math.inf)
    assert found[M].level == NO


def test_presence_is_a_matter_of_slots_alone() -> None:
    """The first message of a stream passes any rate at once."""
    description = describe(layout_of(POSE))
    word = DataWord.PRESENCE

    def level(**limits: float) -> str:
        given = [Restriction(None, (), **limits)] if limits else []  # type: ignore[arg-type]
        return assess(description, given, None, [word])[word].level

    assert [level(), level(rate=1 / 60), level(slot=30)] == [EXACT] * 3
    assert [level(slot=60), level(slot=3600)] == ["minute", "hour"]


def test_a_slot_is_a_rate_too() -> None:
    rules = filter_rules({"pose.position": rounded(4, 2), "pose.orientation": CLEAR})
    given = [Restriction(POSE, (), rules, slot=60)]
    assert assess(describe(layout_of(POSE)), given)[P].level == "room"


@pytest.mark.parametrize(
    ("name", "word", "level"), [("coarse-position", P, "room"), ("blurred-camera", DataWord.IMAGE, "blurred")]
)
def test_presets_are_at_a_level(name: str, word: DataWord, level: str) -> None:
    kind = "sensor_msgs/Image" if word is DataWord.IMAGE else ODOMETRY
    given = [preset(name).restriction(layout_of(kind))]
    assert assess(describe(layout_of(kind)), given)[word].level == level


def test_a_word_that_only_relatives_tell_can_be_asked_for() -> None:
    twist = describe(layout_of("geometry_msgs/Twist"))
    assert assess(twist, [], None, [P])[P].level == EXACT
    assert P not in assess(twist, [])


def test_part_of_a_picture_is_not_the_picture() -> None:
    region = {"across": 8, "block": 64, "x": 0, "y": 0, "width": 9, "height": 9}
    assert seen("sensor_msgs/Image", 1, data={"pixelate": region})[DataWord.IMAGE].level == EXACT
    for levels, level in ((8, "blurred"), (4, "blurred"), (9, EXACT), (None, EXACT)):
        rule = {"across": 16, "block": 64} | ({"levels": levels} if levels else {})
        assert seen("sensor_msgs/Image", 1, data={"pixelate": rule})[DataWord.IMAGE].level == level


def test_squares_of_so_many_pixels_are_no_level() -> None:
    """A grant of long ago: in a large picture they show a face."""
    for size in ({"block": 32}, {"block": 500}, {"across": 17, "block": 32}, {"across": 16}):
        rule = {"levels": 8} | size
        assert seen("sensor_msgs/Image", 1, data={"pixelate": rule})[DataWord.IMAGE].level == EXACT
    full = {"across": 16, "block": 32, "levels": 8}
    assert seen("sensor_msgs/Image", 2, data={"pixelate": full})[DataWord.IMAGE].level == EXACT


def test_a_text_cut_to_nothing_is_hidden() -> None:
    name = "sensor_msgs/TimeReference"
    assert seen(name, source={"truncate": {"length": 0}})[DataWord.IDENTITY].level == NO
    assert seen(name, source={"truncate": {"length": 1}})[DataWord.IDENTITY].level == EXACT


def test_a_relative_in_coarse_steps_is_as_coarse_as_its_level() -> None:
    battery = describe(layout_of("sensor_msgs/BatteryState"))
    for level, metres in (("room", 20.0), ("area", 20.0), (NO, math.inf)):  # quarters of both
        found = resolve(layout_of("sensor_msgs/BatteryState"), battery, {P: level})
        given = Restriction("sensor_msgs/BatteryState", (), found.rules, found.rate, slot=found.slot)
        sight = assess(battery, [given], None, [P])[P]
        assert (sight.level, sight.size) == (level, metres)
    open_one = assess(battery, [Restriction("sensor_msgs/BatteryState", (), (), 0.001)], None, [P])
    assert (open_one[P].level, open_one[P].size) == (EXACT, 0)
    climate = describe(layout_of("sensor_msgs/Temperature"))
    rules = resolve(layout_of("sensor_msgs/Temperature"), climate, {P: "room"})
    given = Restriction("sensor_msgs/Temperature", (), rules.rules, rules.rate)
    assert assess(climate, [given], None, [P])[P].size == 4


def test_pseudonyms_of_names_in_a_fixed_order_are_no_level() -> None:
    hashed: dict[str, object] = {"hash": {"key": "identity", "per": "receiver"}}
    rules = filter_rules({"name": hashed, "header": CLEAR})
    joints = describe(layout_of("sensor_msgs/JointState"))
    found = assess(joints, [Restriction("sensor_msgs/JointState", (), rules)])
    assert found[DataWord.IDENTITY].level == EXACT


def test_degrees_are_measured_in_metres() -> None:
    rules: dict[str, dict[str, object]] = {
        "status": CLEAR,
        "latitude": rounded(0.001),
        "longitude": rounded(0.001),
        "altitude": CLEAR,
        "position_covariance": CLEAR,
        "position_covariance_type": CLEAR,
    }
    assert seen("sensor_msgs/NavSatFix", None, **rules)[P].size == pytest.approx(111.32)


CLEARED = {"pose.position": CLEAR, "pose.orientation": CLEAR}


def with_condition(*texts: str, rate: float | None = 1 / 300) -> dict[DataWord, Seen]:
    given = [Restriction(POSE, texts, filter_rules(CLEARED), rate)]
    return assess(describe(layout_of(POSE)), given)


@pytest.mark.parametrize("text", ["msg.pose.position.x < 5", "5 > msg.pose.position.x + 1"])
def test_a_field_that_a_condition_reads_is_open(text: str) -> None:
    assert with_condition()[P].level == NO
    found = with_condition(text)[P]
    assert (found.level, found.besides, found.size) == (EXACT, NO, 0.0)
    assert found.conditions == (text,)
    assert found.open == ("pose.position.x",)
    assert not found.is_no_finer_than(NO)
    assert not found.is_no_finer_than(0.001)


def test_a_condition_that_reads_no_field_of_a_word_changes_nothing() -> None:
    clean = with_condition()
    assert with_condition('msg.header.frame_id == "map" && now.getHours() > 8') == clean


def test_a_condition_of_another_grant_counts_too() -> None:
    hidden = Restriction(POSE, (), filter_rules(CLEARED))
    asked = Restriction(POSE, ("msg.pose.orientation.w > 0.5",))
    found = assess(describe(layout_of(POSE)), [hidden, asked])
    assert [each.level for each in found.values()] == [EXACT, EXACT]


@pytest.mark.parametrize("rate", [None, 10.0, 1.0, 0.21])
def test_steps_at_a_high_rate_are_no_size(rate: float | None) -> None:
    found = seen(POSE, rate, pose__position=rounded(2, 1), pose__orientation=CLEAR)[P]
    assert found.is_often
    assert (found.size_text, found.step_text) == ("", "2 m")
    assert not found.is_no_finer_than(2)
    slow = seen(POSE, 0.2, pose__position=rounded(2, 1), pose__orientation=CLEAR)[P]
    assert (slow.size_text, slow.is_no_finer_than(2)) == ("2 m", True)


def test_a_pseudonym_for_all_receivers_is_not_one_of_each() -> None:
    key: dict[str, object] = {"hash": {"key": "ward"}}
    own: dict[str, object] = {"hash": {"key": "ward", "per": "receiver"}}
    kind = "actionlib_msgs/GoalID"
    identity = DataWord.IDENTITY
    words = {
        rule: assess(
            describe(layout_of(kind)), [Restriction(kind, (), filter_rules({"id": given}))], None, [identity]
        )[identity]
        for rule, given in (("key", key), ("own", own))
    }
    assert (words["own"].level, words["own"].is_shared) == ("pseudonym", False)
    assert (words["key"].level, words["key"].is_shared) == (EXACT, True)
