"""Rooms in place of cells: which rules become rooms, and what a receiver learns then."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grants.errors import FilterRefused
from grants.filters.layout import parse
from grants.model import FilterRule, Restriction
from grants.vocabulary.assess import assess
from grants.vocabulary.contents import Content, DataWord, describe
from grants.vocabulary.levels import OPERATOR, Treatment, in_rooms, plan_treatment, resolve, smallest
from tests.grants.vocabulary.layouts import layout_of
from tests.grants.vocabulary.made import NOW, Maker, guard_of

POSE = "geometry_msgs/PoseStamped"
PLAN = plan_treatment({"kitchen": "0 0, 4 3", "hall": "4 0, 9 3"})
ROOM = {DataWord.POSITION: "room"}
STEPS = (("hysteresis", 2.0), ("step", 4.0))


def test_a_plan_is_an_operator_with_hysteresis() -> None:
    assert PLAN.operator == OPERATOR
    assert dict(PLAN.parameters)["hysteresis"] == 0.5
    assert smallest(PLAN) == 12


@pytest.mark.parametrize(
    "plan", [{}, {"a": "0 0"}, {"a": "0 0, 0.9 1"}, {"hysteresis": "0 0, 4 3"}, {"a": 7}]
)
def test_what_is_no_plan_is_refused(plan: dict[str, str]) -> None:
    with pytest.raises(FilterRefused):
        plan_treatment({**plan})


def test_only_the_cell_of_a_whole_position_becomes_its_room() -> None:
    layout = layout_of(POSE)
    whole = FilterRule("pose.position", "round", STEPS)
    assert in_rooms(layout, whole, PLAN) == FilterRule("pose.position", *PLAN)
    for other in (
        FilterRule("pose.position.x", "round", STEPS),
        FilterRule("pose.orientation", "clear"),
        FilterRule("pose.position", "round", (("hysteresis", 2.0), ("step", 5.0))),
        FilterRule("nothing.there", "round", STEPS),
    ):
        assert in_rooms(layout, other, PLAN) == other


def test_where_rooms_do_not_fit_the_cells_stay() -> None:
    layout = parse("acme_msgs/At", "float64 x\nfloat64 y\nfloat64 w")
    here = dict.fromkeys("xyw", Content.COORDINATE)
    found = resolve(layout, describe(layout, here=here), ROOM, PLAN)
    assert {rule.operator for rule in found.rules} == {"round"}


def test_an_area_is_refused() -> None:
    layout = layout_of(POSE)
    with pytest.raises(FilterRefused, match="a position has no area"):
        resolve(layout, describe(layout), {DataWord.POSITION: "area"}, PLAN)
    resolve(layout, describe(layout), {DataWord.POSITION: "no"}, PLAN)


def seen(treatment: Treatment) -> tuple[str, float]:
    layout = layout_of(POSE)
    rules = (FilterRule("pose.orientation", "clear"), FilterRule("pose.position", *treatment))
    found = assess(describe(layout), [Restriction(POSE, (), rules, 1 / 30)])
    return found[DataWord.POSITION].level, found[DataWord.POSITION].size


@pytest.mark.parametrize(
    ("treatment", "level", "size"),
    [
        (PLAN, "room", math.sqrt(12)),
        (Treatment(OPERATOR, (("a", "0 0, 4 3"),)), "exact", math.sqrt(12)),
        (Treatment(OPERATOR, (("a", "0 0, 0.1 0.1"), ("hysteresis", 0.5))), "exact", 0.1),
        # A millimetre wide, or kept for a millimetre: where it is, not the room.
        (Treatment(OPERATOR, (("a", "0 0, 0.001 1000"), ("hysteresis", 0.5))), "exact", 0.004),
        (Treatment(OPERATOR, (("a", "0 0, 4 3"), ("hysteresis", 0.001))), "exact", math.sqrt(12)),
    ],
)
def test_rooms_are_said_to_be_the_room_if_they_are_rooms(
    treatment: Treatment, level: str, size: float
) -> None:
    found = seen(treatment)
    assert found[0] == level
    assert math.isclose(found[1], size, rel_tol=1e-5)


def test_a_plan_of_strips_is_refused() -> None:
    with pytest.raises(FilterRefused, match=r"narrower than 0\.4 metres"):
        plan_treatment({"a": "0 0, 0.001 1000", "b": "0.001 0, 0.002 1000"})
    plan_treatment({"corridor": "0 0, 0.8 30", "bath": "0 0, 1 1"})


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.integers(0, 2**32), st.booleans())
def test_two_places_in_a_room_are_the_same_to_the_receiver(one: int, other: int, in_hall: bool) -> None:
    """Whatever else the two messages say that tells a position."""
    layout = layout_of(POSE)
    found = resolve(layout, describe(layout), ROOM, PLAN)
    low = 4.1 if in_hall else 0.1

    def message(seed: int) -> bytes:
        made = Maker(7, seed, lambda path: path != "header.frame_id")(layout)
        at = len(made) - 56  # seven doubles end a pose
        x, y = low + seed % 1000 / 1000 * 3.8, 0.1 + seed % 777 / 777 * 2.8
        return made[:at] + struct.pack("<2d", x, y) + made[at + 16 :]

    first, second = (b"".join(guard_of(layout, found)(message(seed), NOW) or ()) for seed in (one, other))
    assert first == second
    assert first != message(one)
