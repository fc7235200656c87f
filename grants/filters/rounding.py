"""Rounding to multiples of a step, for every number type, one value or a whole array.

`floor(x / step + 1/2) * step`: equal values always have the same cell; unlike "half to even" all
cells have the same size. Values stay in their type's range (the last multiple in it), NaN and
infinities pass. One value and an array of it give the same bits: tests compare them.
"""

import math
import sys
from collections.abc import Callable
from typing import Any, Final, TypeAlias

from grants.common_state import HysteresisState
from grants.errors import FilterRefused
from grants.filters.layout import Primitive
from grants.filters.lazy_numpy import Vector, np

Rounding: TypeAlias = tuple[Callable[..., Any], Callable[[Vector], Vector]]

_SECOND: Final = 10**9
_FLOAT_MAX: Final = {"f": float.fromhex("0x1.fffffep+127"), "d": sys.float_info.max}


def round_floats(kind: Primitive, step: float) -> Rounding:
    """For float32 and float64; computed in 64 bits, like the values of genpy."""
    step = float(step)
    largest = _FLOAT_MAX[kind.code]
    cells = largest / step
    last = min(math.floor(cells) * step, largest) if math.isfinite(cells) else largest
    # Below this the plain formula is correct (NaN is never below): the cell is within 2^53 of
    # zero, where half a cell is still representable, and its value in the type's range.
    plain = min(cells - 1, 2.0**52)
    square = max(plain, 0.0) ** 2

    def scalar(value: float) -> float:
        cell = value / step
        if -plain < cell < plain:
            return (cell + 0.5) // 1.0 * step
        if not math.isfinite(cell):  # NaN, infinite, or a step far below the value's precision
            return value
        return min(max(math.floor(cell + 0.5) * step, -last), last)

    # Arrays without dimensions: numpy takes them faster than Python's floats.
    width, half = np.array(step), np.array(0.5)

    @np.errstate(all="ignore")
    def vector(values: Vector) -> Vector:
        cells = values.astype(np.float64)
        cells /= width
        # The norm is an upper bound of every cell, at a tenth of the price of a maximum.
        if np.vdot(cells, cells) < square:
            cells += half
            np.floor(cells, cells)
            cells *= width
            return cells
        rounded = np.clip(np.floor(cells + half) * width, -last, last)
        return np.where(np.isfinite(cells), rounded, values.astype(np.float64))

    return scalar, vector


def round_integers(kind: Primitive, step: float) -> Rounding:
    """For all integers; exact.

    Raises:
        FilterRefused: the step is not whole, or larger than the type's range.
    """
    bits = 8 * kind.size
    low, high = (
        (0, (1 << bits) - 1) if kind.code.isupper() else (-(1 << bits - 1), (1 << bits - 1) - 1)
    )
    if not float(step).is_integer() or step > high:
        raise FilterRefused(f"a step for {kind.name} must be whole and at most {high}")
    scalar = _exact(int(step), low, high)
    whole = int(step)
    first, last = -(-low // whole) * whole, high // whole * whole

    def small(values: Vector) -> Vector:
        wide = values.astype(np.int64)
        return np.clip((2 * wide + whole) // (2 * whole) * whole, first, last)

    def large(values: Vector) -> Vector:  # 64 bits leave numpy no headroom
        rounded = [scalar(value) for value in values.reshape(-1).tolist()]
        return np.array(rounded, values.dtype).reshape(values.shape)

    return scalar, small if kind.size < 8 else large


def round_times(kind: Primitive, step: float) -> Rounding:
    """For time and duration, as pairs (seconds, nanoseconds); `step` in seconds.

    Raises:
        FilterRefused: the step is not between a nanosecond and 2^31 seconds.
    """
    ticks = round(step * _SECOND) if step < 1 << 31 else 0
    if ticks < 1:
        raise FilterRefused(f"a step for {kind.name} must lie between 1e-9 and 2^31 seconds")
    low, high = (0, (1 << 32) - 1) if kind.name == "time" else (-(1 << 31), (1 << 31) - 1)
    exact = _exact(ticks, low * _SECOND, high * _SECOND + _SECOND - 1)

    def scalar(seconds: int, nanoseconds: int) -> tuple[int, int]:
        return divmod(exact(seconds * _SECOND + nanoseconds), _SECOND)

    def vector(values: Vector) -> Vector:
        pairs = [scalar(*pair) for pair in values.reshape(-1, 2).tolist()]
        return np.array(pairs, values.dtype).reshape(values.shape)

    return scalar, vector


def _exact(step: int, low: int, high: int) -> Callable[[int], int]:
    first, last = -(-low // step) * step, high // step * step

    def scalar(value: int) -> int:
        return min(max((2 * value + step) // (2 * step) * step, first), last)

    return scalar


def with_hysteresis(
    scalar: Callable[[float], float], step: float, hysteresis: float
) -> Callable[[HysteresisState], Callable[[float], float]]:
    """Rounding that stays in its cell until the value is `hysteresis` beyond the border.

    A value that varies around a border would otherwise reveal, by the changes, exactly where it
    is. Returns a function from state to `scalar`: one state for each field of each holder.
    """
    reach = step / 2 + hysteresis

    def bind(state: HysteresisState) -> Callable[[float], float]:
        def scalar_with_hysteresis(value: float) -> float:
            previous = state.value
            # With NaN the comparison is false; NaN and infinities pass and are not stored.
            if previous is not None and abs(value - previous) <= reach:
                return previous
            rounded = scalar(value)
            if math.isfinite(rounded):
                state.value = rounded
            return rounded

        return scalar_with_hysteresis

    return bind
