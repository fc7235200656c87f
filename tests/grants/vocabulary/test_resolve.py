"""Levels as filters: the rules of some types, and properties of all of them, through the guard."""

import random  # noqa: TID251 - seeded, for reproducible failures

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grants.errors import FilterRefused
from grants.filters.layout import parse
from grants.vocabulary.contents import (
    EXACT,
    FRAMES,
    LEVELS,
    NO,
    TIMES,
    Content,
    DataWord,
    FieldContent,
    describe,
)
from grants.vocabulary.levels import Levels, Resolved, level_of, resolve
from tests.grants.vocabulary.layouts import STANDARD, layout_of
from tests.grants.vocabulary.made import Maker, through

ROOM: Levels = {DataWord.POSITION: "room"}
BARE = {name for name in STANDARD if describe(layout_of(name)).unknown}
TYPES = sorted(set(STANDARD) - BARE)
LEVEL_PAIRS = [(word, level) for word in DataWord for level in LEVELS[word][1:]]
NUMBERS = st.integers(0, 2**32)


def resolved(name: str, **levels: str) -> Resolved:
    layout = layout_of(name)
    said = {DataWord(word): level for word, level in levels.items()}
    return resolve(layout, describe(layout), said)


def rules(name: str, **levels: str) -> list[str]:
    return [str(rule) for rule in resolved(name, **levels).rules]


def test_an_odometry_at_the_room() -> None:
    assert rules("nav_msgs/Odometry", position="room") == [
        "child_frame_id: clear",
        "header.seq: clear",
        "header.stamp: clear",
        "pose.covariance: clear",
        "pose.pose.orientation: clear",
        "pose.pose.position: round hysteresis 2.0 step 4.0",
        "twist: clear",
    ]
    assert resolved("nav_msgs/Odometry", position="room").slot == 30


@pytest.mark.parametrize(
    ("levels", "slot"),
    [
        ({"position": "room"}, 900),
        ({"position": "area"}, 3600),
        ({"position": "no"}, 3600),
        ({"movement": "rough"}, 900),
        ({"movement": "no"}, 900),
    ],
)
def test_outdoors_a_slot_follows_the_cell(levels: dict[str, str], slot: int) -> None:
    """At 8 m/s a sample every 30 s tells where the border of a cell of 2.2 km was crossed."""
    assert resolved("sensor_msgs/NavSatFix", **levels).slot == slot


def test_a_hidden_position_takes_the_frame_with_it() -> None:
    assert "header: clear" in rules("geometry_msgs/PoseStamped", position="no")


def test_positions_in_an_array_are_not_shown_in_part() -> None:
    """Their number and order would tell more than each of them."""
    assert "poses: clear" in rules("nav_msgs/Path", position="area")
    assert "poses: clear" in rules("geometry_msgs/PoseArray", position="room")


def test_names_in_an_array_are_hidden_one_by_one() -> None:
    found = rules("diagnostic_msgs/DiagnosticArray", identity="pseudonym")
    assert "status[*].hardware_id: hash key identity per receiver" in found
    assert "status[*].message: clear" in found
    assert "status: sort" in found  # the order would tell which is which
    assert {"header.stamp: clear", "header.seq: clear"} <= set(found)  # equal for two receivers


def test_times_stay_where_there_are_no_names() -> None:
    """The frame alone has a pseudonym: a policy may treat the stamp by a filter beside it."""
    assert rules("geometry_msgs/PoseStamped", identity="pseudonym") == [
        "header.frame_id: hash key identity per receiver"
    ]


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("sensor_msgs/JointState", "name"),
        ("sensor_msgs/MultiDOFJointState", "joint_names"),
        ("trajectory_msgs/JointTrajectory", "joint_names"),
        ("trajectory_msgs/MultiDOFJointTrajectory", "joint_names"),
    ],
)
def test_names_in_a_fixed_order_have_no_pseudonyms(name: str, field: str) -> None:
    """The third joint of a robot is the third for every receiver."""
    assert f"{field}: clear" in rules(name, identity="pseudonym")


@pytest.mark.parametrize("word", ["position", "movement"])
def test_goals_are_not_counted(word: str) -> None:
    assert {"status_list: clear"} <= set(rules("actionlib_msgs/GoalStatusArray", **{word: "no"}))
    layout = parse(
        "acme_msgs/Goals",
        "actionlib_msgs/GoalID[] goals\n" + "=" * 80 + "\nMSG: actionlib_msgs/GoalID\ntime stamp\nstring id",
    )
    said = {DataWord(word): "no", DataWord.IDENTITY: NO}
    described = describe(layout, here={"goals": Content.REQUEST})
    assert "goals: clear" in map(str, resolve(layout, described, said).rules)
    assert "goals: sort" not in map(str, resolve(layout, described, said).rules)


def test_a_path_keeps_its_order_when_frames_have_pseudonyms() -> None:
    assert "poses: sort" not in rules("nav_msgs/Path", identity="pseudonym")
    assert "status_list: sort" in rules("actionlib_msgs/GoalStatusArray", identity="no")


def test_an_array_of_fixed_length_is_not_sorted() -> None:
    layout = parse(
        "acme_msgs/Pair", "Part[2] parts\n" + "=" * 80 + "\nMSG: acme_msgs/Part\nstring name\nfloat64 value"
    )
    own = {"acme_msgs/Part": {"name": Content.NAME, "value": Content.READING}}
    found = resolve(layout, describe(layout, own), {DataWord.IDENTITY: "pseudonym"})
    assert [rule.path for rule in found.rules] == ["parts[*].name"]


def test_a_picture_stays_one_that_can_be_read() -> None:
    assert "data: zero" in rules("sensor_msgs/Image", image="no")
    assert "data: pixelate across 16 block 32 levels 8" in rules("sensor_msgs/Image", image="blurred")


def test_what_cannot_be_blurred_is_hidden() -> None:
    assert "data: clear" in rules("sensor_msgs/CompressedImage", image="blurred")


def test_a_level_of_the_picture_decides_what_may_be_recognised_in_it() -> None:
    assert "data: zero" in rules("sensor_msgs/Image", position="room")
    found = resolved("sensor_msgs/Image", position="room", image="blurred", home="no")
    assert "data: pixelate across 16 block 32 levels 8" in map(str, found.rules)
    assert found.rate == 1.0


def test_the_strictest_of_two_words_holds() -> None:
    found = rules("nav_msgs/Odometry", position="area", movement="rough")
    assert "pose.pose.position: round hysteresis 10.0 step 20.0" in found
    assert "twist: clear" in found


def test_a_level_does_not_touch_what_does_not_tell_it() -> None:
    assert resolved("sensor_msgs/TimeReference", position="no") == Resolved()
    assert resolved("geometry_msgs/PoseStamped", sound="no") == Resolved()
    assert resolved("std_msgs/Float64", position=EXACT) == Resolved()


def test_an_unknown_field_is_refused() -> None:
    layout = parse("acme_msgs/Person", "string who")
    with pytest.raises(FilterRefused, match="what who of acme_msgs/Person tells is not") as caught:
        resolve(layout, describe(layout), {DataWord.SOUND: NO})
    assert caught.value.hint == "say it: vocabulary: {acme_msgs/Person: {who: position}}"


@pytest.mark.parametrize("name", sorted(BARE))
def test_a_bare_value_is_refused_below_exact(name: str) -> None:
    for word, level in LEVEL_PAIRS:
        if word is DataWord.PRESENCE:
            assert resolved(name, presence=level).slot is not None
            continue
        with pytest.raises(FilterRefused, match="only its topic knows"):
            resolved(name, **{word: level})


def test_exact_is_refused_for_what_another_level_hides() -> None:
    with pytest.raises(FilterRefused, match="movement cannot be exact beside position: room"):
        resolved("nav_msgs/Odometry", position="room", movement=EXACT)
    assert rules("geometry_msgs/PointStamped", position="room", movement=EXACT)


def test_an_operator_that_does_not_fit_the_field_hides_it() -> None:
    layout = parse("acme_msgs/Places", "float64[3] at\nstring room")
    said = {"at": Content.COORDINATE, "room": Content.COORDINATE}
    found = resolve(layout, describe(layout, here=said), ROOM)
    assert [str(rule) for rule in found.rules] == ["at: clear", "room: clear"]


# --- properties of every type, by messages put through the compiled guard ---

PAIRS = [
    (word, finer, coarser)
    for word in DataWord
    for finer, coarser in zip(LEVELS[word][1:], LEVELS[word][2:], strict=False)
]


def check_coarser_is_a_function_of_finer(
    name: str, word: DataWord, finer: str, coarser: str, seed: int
) -> None:
    """So whoever has the finer one learns nothing by the coarser one."""
    layout = layout_of(name)
    message = Maker(seed, seed)(layout)
    once = through(layout, {word: coarser}, message)
    assert through(layout, {word: coarser}, through(layout, {word: finer}, message)) == once


@pytest.mark.parametrize(("word", "finer", "coarser"), PAIRS)
def test_a_level_lets_through_no_more_than_the_one_before(word: DataWord, finer: str, coarser: str) -> None:
    for name in TYPES:
        check_coarser_is_a_function_of_finer(name, word, finer, coarser, sum(name.encode()))


@settings(max_examples=100)
@given(st.sampled_from(TYPES), st.sampled_from(PAIRS), NUMBERS)
def test_of_any_message_neither(name: str, pair: tuple[DataWord, str, str], seed: int) -> None:
    check_coarser_is_a_function_of_finer(name, *pair, seed)


def hidden_at(name: str, word: DataWord, level: str) -> set[str]:
    """Paths of fields, and of arrays of messages, that tell the word and are shown in no part."""

    def is_hidden(field: FieldContent) -> bool:
        shown = level_of(word, level).treatments.get(field.content, "hidden") != "hidden"
        told = word in field.meaning.tells | field.meaning.hints
        return told and (not shown or (field.array != "" and field.content not in FRAMES))

    fields = [field for field in describe(layout_of(name)).fields if is_hidden(field)]
    in_place = {Content.NAME, Content.MARK, Content.TEXT} | FRAMES | TIMES
    arrays = {field.array for field in fields if field.content not in in_place}
    inside = [f.path for f in describe(layout_of(name)).fields if f.array and f.array in arrays]
    return {*(field.path for field in fields), *arrays, *inside} - {""}


def check_nothing_gives_it_away(name: str, word: DataWord, level: str, seeds: list[int]) -> None:
    """Messages that differ in every relative and within a cell are the same to the receiver."""
    layout = layout_of(name)
    if not describe(layout).tells(word):
        return
    hidden = hidden_at(name, word, level)
    treatments = level_of(word, level).treatments
    of = {field.path: field for field in describe(layout).fields}

    def cell(path: str) -> float:
        treatment = treatments.get(of[path].content)
        step = 0.0 if treatment is None else float(dict(treatment.parameters).get("step", 0))
        return 0.0 if path in hidden else step

    one, *others = (Maker(seeds[0], other, hidden.__contains__, cell)(layout) for other in seeds)
    if word is DataWord.IMAGE and level == "blurred":
        return  # a picture within its squares: test_pictures
    for other in others:
        assert through(layout, {word: level}, one) == through(layout, {word: level}, other)


@pytest.mark.parametrize(("word", "level"), LEVEL_PAIRS)
def test_nothing_in_the_message_gives_a_level_away(word: DataWord, level: str) -> None:
    for name in TYPES:
        rng = random.Random(sum(name.encode()))
        check_nothing_gives_it_away(name, word, level, [rng.getrandbits(32) for _ in range(3)])


@settings(max_examples=100)
@given(st.sampled_from(TYPES), st.sampled_from(LEVEL_PAIRS), NUMBERS, NUMBERS)
def test_in_any_message_neither(name: str, pair: tuple[DataWord, str], seed: int, other: int) -> None:
    check_nothing_gives_it_away(name, *pair, [seed, other])


@pytest.mark.parametrize(
    "part",
    [
        "orientation",
        "rotation",
        "quaternion",
        "theta",
        "linear",
        "angular",
        "twist",
        "covariance",
        "velocity",
        "ranges",
        "intensities",
        "stamp",
        "seq",
        "effort",
        "accel",
        "magnetic_field",
    ],
)
def test_a_field_by_this_name_never_stays_beside_a_coarse_position(part: str) -> None:
    """By names, not by the table: a slip in it would be found."""
    seen = 0
    for name in TYPES:
        found = resolved(name, position="room").rules
        paths = [f.path for f in describe(layout_of(name)).fields if part in f.path.split(".")]
        for path in paths if found else []:
            hidden = any(f"{path}.".startswith((f"{r.path}.", f"{r.path}[")) for r in found)
            assert hidden, (name, path)
            seen += 1
    assert seen


@pytest.mark.parametrize("word", ["position", "home", "image"])
def test_a_cloud_is_cleared_as_a_whole_in_either_form(word: str) -> None:
    """Of a PointCloud the points were left, which show the home as those of a PointCloud2 do."""
    found = rules("sensor_msgs/PointCloud", **{word: "no"})
    assert {"points: clear", "channels: clear"} <= set(found)


def test_an_array_of_values_does_not_say_how_many_it_had() -> None:
    layout = layout_of("std_msgs/Float32MultiArray")
    described = describe(layout, here={"data": Content.READING})
    found = {str(rule) for rule in resolve(layout, described, {DataWord.HOME: NO}).rules}
    assert found == {"data: clear", "layout: clear"}
