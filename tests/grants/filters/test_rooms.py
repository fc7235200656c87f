"""Rooms: which room a position is in, the point that stands for it, and what no plan may be."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.errors import FilterRefused
from grants.filters.coarsening import HysteresisState, Room, read_plan, snap_rows, snapping

FLAT = {"bath": "4 0, 6 2", "hall": "4 2, 6 2, 6 5, 0 5, 0 4, 4 4", "kitchen": "0 0, 4 4"}
PLAN = read_plan(FLAT)
POINTS = {room.name: room.point for room in PLAN}
COORDINATES = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-1, 7)


def snapped(*place: float, plan: tuple[Room, ...] = PLAN) -> tuple[float, ...]:
    return snapping(plan, None)(HysteresisState())(*place)


def test_a_rectangle_is_written_by_two_corners_and_stands_for_its_middle() -> None:
    assert POINTS == {"bath": (5.0, 1.0), "hall": (3.0, 4.5), "kitchen": (2.0, 2.0)}
    for written in ("0 0, 4 4", "4 4,0 0", "0 4, 4 0", "0 0, 4 0, 4 4, 0 4"):
        assert read_plan({"kitchen": written})[0].point == (2.0, 2.0)


@pytest.mark.parametrize(
    ("place", "room"),
    [((1, 1, 9), "kitchen"), ((3.999, 0, 0), "kitchen"), ((4, 0, 0), "bath"), ((1, 4.5, 0), "hall")],
)
def test_a_position_becomes_the_point_of_its_room(place: tuple[float, ...], room: str) -> None:
    assert snapped(*place) == (*POINTS[room], 0.0)


@given(x=COORDINATES, y=COORDINATES, z=COORDINATES)
def test_a_position_tells_its_room_or_nothing(x: float, y: float, z: float) -> None:
    """Whatever it was: one of as many results as there are rooms, or no number at all."""
    found = snapped(x, y, z)
    assert found in {(*point, 0.0) for point in POINTS.values()} or all(map(math.isnan, found))


@given(x=st.floats(0, 6, exclude_max=True), y=st.floats(0, 5, exclude_max=True))
def test_rooms_with_common_walls_have_no_gap_and_no_overlap(x: float, y: float) -> None:
    assert sum(room.covers(x, y) for room in PLAN) == 1


def test_a_room_may_have_any_form_and_its_point_is_inside() -> None:
    forms = ["0 0, 9 0, 9 1, 1 1, 1 8, 9 8, 9 9, 0 9", "0 0, 4 0, 2 5", "0 0, 2 2, 4 0, 2 9"]
    for text in forms:
        [room] = read_plan({"a": text})
        assert room.covers(*room.point)


def test_of_two_rooms_the_first_by_name_counts() -> None:
    plan = read_plan({"b": "0 0, 9 9", "a": "1 1, 3 3"})
    assert snapped(2, 2, plan=plan) == (2.0, 2.0)
    assert snapped(4, 4, plan=plan) == (4.5, 4.5)


def test_with_hysteresis_a_room_is_kept_until_the_position_is_far_outside() -> None:
    snap = snapping(PLAN, 0.5)(HysteresisState())
    walked = [(3.9, 1), (4.4, 1), (4.6, 1), (3.6, 1), (4.1, 1), (9, 9), (6.2, 1), (5.9, 1)]
    kitchen, bath = POINTS["kitchen"], POINTS["bath"]
    found = [snap(*place) for place in walked]
    assert found[:5] == [kitchen, kitchen, bath, bath, bath]
    assert all(map(math.isnan, (*found[5], *found[6]))), "outside, there is nothing to keep"
    assert found[7] == bath


@given(st.lists(st.tuples(st.floats(3.6, 4.4), st.floats(0.1, 1.9)), min_size=1))
def test_with_hysteresis_a_position_at_a_door_tells_one_room(walked: list[tuple[float, float]]) -> None:
    snap = snapping(PLAN, 0.5)(HysteresisState())
    assert len({snap(*place) for place in walked}) == 1


def test_arrays_of_positions() -> None:
    snap = snapping(PLAN, None)(HysteresisState())
    places = np.array([[1, 1, 7], [5, 1, 7], [-1, 0, 0]], "<f4")
    for form in (places, places.reshape(1, -1)):
        found = snap_rows(snap, 3)(form)
        assert (found.dtype, found.shape) == (form.dtype, form.shape)
        flat = found.reshape(-1, 3).tolist()
        assert flat[:2] == [[2.0, 2.0, 0.0], [5.0, 1.0, 0.0]]
        assert all(map(math.isnan, flat[2]))


REFUSED: dict[str, tuple[dict[str, object], str]] = {
    "no room": ({}, "1 to 64 rooms"),
    "too many rooms": ({f"r{n}": "0 0, 1 1" for n in range(65)}, "1 to 64 rooms"),
    "too many corners": (
        {f"r{n}": ", ".join(f"{a} {b}" for a, b in product(range(11), repeat=2)) for n in range(5)},
        "more than 512 corners",
    ),
    "a name in other letters": ({"Kitchen": "0 0, 1 1"}, "not the name of a room: 'Kitchen'"),
    "a number": ({"kitchen": 1}, "room kitchen has no corners: '1'"),
    "one corner": ({"kitchen": "0 0"}, "has no corners"),
    "half a corner": ({"kitchen": "0 0, 1"}, "has no corners"),
    "no number": ({"kitchen": "0 0, nan 1"}, "has no corners"),
    "an exponent": ({"kitchen": "0 0, 1e3 1"}, "has no corners"),
    "a line end": ({"kitchen": "0 0, 1 1\n"}, "has no corners"),
    "too long": ({"kitchen": ", ".join(["0 0"] * 300)}, "has no corners"),
    "too far": ({"kitchen": "0 0, 1000000 1"}, "has no corners"),
    "a line": ({"kitchen": "0 0, 4 0, 8 0"}, "room kitchen has no area"),
    "a flat rectangle": ({"kitchen": "0 0, 0 4"}, "room kitchen has no area"),
    "there and back": ({"kitchen": "0 0, 4 4, 4 0, 4 4"}, "room kitchen has no area"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_plan_is_refused(name: str) -> None:
    texts, message = REFUSED[name]
    with pytest.raises(FilterRefused, match=message) as refused:
        read_plan(texts)
    assert refused.value.hint
