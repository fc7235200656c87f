"""Rounding: the formula, the range, and arrays equal single values bit for bit."""

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.errors import FilterRefused
from grants.filters.coarsening import (
    HysteresisState,
    round_floats,
    round_integers,
    round_times,
    with_hysteresis,
)
from grants.filters.layout import PRIMITIVES

STEPS = st.floats(min_value=1e-320, max_value=1e308) | st.sampled_from([0.1, 0.5, 1.0, 2.0, 1e40])
FLOATS = {"float32": st.floats(width=32), "float64": st.floats()}
INTEGERS = [n for n, kind in PRIMITIVES.items() if kind.code in "bBhHiIqQ" and n != "bool"]


def bits(kind: str, values: list[Any]) -> bytes:
    return struct.pack(f"<{len(values)}{PRIMITIVES[kind].code}", *values)


@pytest.mark.parametrize("kind", FLOATS)
@given(data=st.data(), step=STEPS)
def test_floats_follow_the_formula(kind: str, data: st.DataObject, step: float) -> None:
    values = data.draw(st.lists(FLOATS[kind], max_size=12))
    scalar, vector = round_floats(PRIMITIVES[kind], step)
    rounded = [scalar(value) for value in values]
    array = np.array(values, f"<{PRIMITIVES[kind].code}")
    with np.errstate(all="ignore"):
        assert vector(array).astype(array.dtype).tobytes() == bits(kind, rounded)
    for before, after in zip(values, rounded, strict=True):
        if not math.isfinite(before):
            assert after == before or math.isnan(before) == math.isnan(after) is True
        elif abs(before / step) < 2**50 and abs(before) < 1e30:
            assert after == math.floor(before / step + 0.5) * step or abs(after) <= abs(before)


def test_floats_stay_in_their_range() -> None:
    scalar, vector = round_floats(PRIMITIVES["float32"], 2e38)
    assert scalar(3.4e38) == 2e38
    assert vector(np.array([3.4e38, -3.4e38])).tolist() == [2e38, -2e38]
    scalar, vector = round_floats(PRIMITIVES["float32"], 1e300)
    assert (scalar(3.4e38), scalar(-1.0)) == (0.0, 0.0)
    assert vector(np.array([1.0, 3e38])).tolist() == [0.0, 0.0]
    scalar, _ = round_floats(PRIMITIVES["float64"], 5e-324)
    assert scalar(1.5) == 1.5


@pytest.mark.parametrize("kind", INTEGERS)
@given(data=st.data())
def test_integers_follow_the_formula(kind: str, data: st.DataObject) -> None:
    primitive = PRIMITIVES[kind]
    values_of = np.iinfo(f"<{primitive.code}")
    low, high = int(values_of.min), int(values_of.max)
    step = data.draw(st.integers(1, high))
    values = data.draw(st.lists(st.integers(low, high) | st.sampled_from([low, high]), max_size=9))
    scalar, vector = round_integers(primitive, step)
    rounded = [scalar(value) for value in values]
    array = np.array(values, f"<{primitive.code}")
    assert vector(array).astype(array.dtype).tobytes() == bits(kind, rounded)
    for before, after in zip(values, rounded, strict=True):
        assert low <= after <= high
        assert after % step == 0
        assert abs(after - before) <= step // 2 or abs(after) < abs(before)


@pytest.mark.parametrize("step", [0.5, 256, 2.5, 1e300])
def test_invalid_integer_steps_are_refused(step: float) -> None:
    with pytest.raises(FilterRefused, match="a step for uint8 must be whole and at most 255"):
        round_integers(PRIMITIVES["uint8"], step)


@pytest.mark.parametrize(
    ("kind", "step", "before", "after"),
    [
        ("time", 60, (90, 0), (120, 0)),
        ("time", 60, (89, 999_999_999), (60, 0)),
        ("time", 0.1, (1, 160_000_000), (1, 200_000_000)),
        ("time", 60, (2**32 - 1, 999_999_999), (4294967280, 0)),
        ("time", 1, (5, 2_000_000_000), (7, 0)),
        ("duration", 1, (-1, 600_000_000), (0, 0)),
        ("duration", 1, (-2, 100_000_000), (-2, 0)),
        ("duration", 60, (-(2**31), 0), (-2147483640, 0)),
    ],
)
def test_times_are_rounded_exactly(
    kind: str, step: float, before: tuple[int, int], after: tuple[int, int]
) -> None:
    scalar, vector = round_times(PRIMITIVES[kind], step)
    assert scalar(*before) == after
    dtype = "<u4" if kind == "time" else "<i4"
    assert vector(np.array([before, before], dtype)).tolist() == [[*after], [*after]]


@pytest.mark.parametrize("step", [1e-10, 2.0**31, 1e300])
def test_invalid_time_steps_are_refused(step: float) -> None:
    with pytest.raises(FilterRefused, match="between 1e-9 and 2"):
        round_times(PRIMITIVES["time"], step)


PLAIN = (lambda value: value if not math.isfinite(value) else math.floor(value + 0.5), 1.0, 0.2)


def test_hysteresis_keeps_the_cell_near_its_border() -> None:
    fresh = with_hysteresis(lambda value: math.floor(value + 0.5), 1, 0.2)
    one, other = fresh(HysteresisState()), fresh(HysteresisState())
    assert [one(x) for x in (0.4, 0.6, 0.7, 0.71, 0.31, 0.3, 0.29)] == [0, 0, 0, 1, 1, 1, 0]
    assert other(0.6) == 1  # has its own state


def test_hysteresis_passes_nan_and_infinity_without_storing_them() -> None:
    held = with_hysteresis(*PLAIN)(HysteresisState())
    assert held(0.6) == 1.0
    assert math.isnan(held(math.nan))
    assert held(math.inf) == math.inf
    assert held(0.4) == 1.0


def test_hysteresis_of_integers() -> None:
    scalar, _ = round_integers(PRIMITIVES["int32"], 10)
    held = with_hysteresis(scalar, 10, 2)(HysteresisState())
    assert [held(value) for value in (4, 6, 7, 8, 3, 2)] == [0, 0, 0, 10, 10, 0]


@given(x=st.floats(-1e6, 1e6), step=st.sampled_from([0.5, 1, 2, 4]), odd=st.sampled_from([3, 5, 7]))
def test_cells_nest_where_one_step_is_an_odd_multiple_of_the_other(x: float, step: float, odd: int) -> None:
    """The coarse cell follows from the fine one: it tells a second receiver nothing more."""
    fine, _ = round_floats(PRIMITIVES["float64"], step)
    coarse, _ = round_floats(PRIMITIVES["float64"], step * odd)
    assert coarse(x) == coarse(fine(x))


def test_cells_of_even_multiples_do_not_nest() -> None:
    fine, _ = round_floats(PRIMITIVES["float64"], 2)
    coarse, _ = round_floats(PRIMITIVES["float64"], 4)
    assert fine(1.5) == fine(2.5)
    assert coarse(1.5) != coarse(2.5)
