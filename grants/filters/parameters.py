"""The parameters of an operator: exactly its own, each of its type and in its range.

They come from a signed grant or from a policy, so everything that is not expected is refused.
"""

import math
from typing import TypeAlias

from grants.errors import FilterRefused
from grants.model import Scalar

Parameters: TypeAlias = dict[str, Scalar]


def expect(parameters: Parameters, *names: str) -> None:
    """Return if there are these parameters and no others.

    Raises:
        FilterRefused: there are others.
    """
    if parameters.keys() != set(names):
        wanted = ", ".join(names) or "no parameters"
        raise FilterRefused(f"expected {wanted}, found {', '.join(sorted(parameters)) or 'none'}")


def number(parameters: Parameters, name: str) -> float:
    """The number `name`, within 64 bits if it is an integer.

    Raises:
        FilterRefused: it is missing, or no number.
    """
    value = parameters.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FilterRefused(f"{name} must be a number")
    if isinstance(value, int) and abs(value) >= 1 << 64:
        raise FilterRefused(f"{name} is beyond 64 bits")
    if math.isnan(value):
        raise FilterRefused(f"{name} must be a number")
    return value


def integer(parameters: Parameters, name: str, maximum: int, minimum: int = 1) -> int:
    """The whole number `name`.

    Raises:
        FilterRefused: it is missing, or not in this range.
    """
    value = parameters.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
        raise FilterRefused(f"{name} must be a whole number from {minimum} to {maximum}")
    return value
