"""What operators let through of a value."""

import pytest

from grants.errors import FilterRefused
from grants.filters.layout import PRIMITIVES, Primitive, Text
from grants.filters.operators import OPERATORS
from grants.model import filter_rules
from grants.policy.assertion_check import _OPERATORS, Passing, Through, passing, size_of

FLOAT, BYTE, SHORT = (PRIMITIVES[name] for name in ("float64", "uint8", "int16"))
SQUARE, CORNERED = "0 0, 4 3", "0 0, 4 0, 0 4"


def of(kind: Primitive | Text, operator: str, path: str = "x", **parameters: object) -> Passing:
    (rule,) = filter_rules({path: {operator: parameters or True}})
    return passing(rule, kind, path)


def test_every_operator_says_what_it_lets_through() -> None:
    assert _OPERATORS.keys() == OPERATORS.keys()


@pytest.mark.parametrize("operator", ["clear", "drop", "zero"])
def test_what_is_constant_lets_nothing_through(operator: str) -> None:
    assert of(FLOAT, operator).through is Through.NOTHING


def test_texts() -> None:
    assert of(Text(), "redact", text="x").through is Through.NOTHING
    assert of(Text(), "truncate", length=0).through is Through.NOTHING
    assert of(Text(), "truncate", length=1).through is Through.TOLD
    assert of(Text(), "hash", key="ward").through is Through.TOLD


def test_numbers() -> None:
    assert of(FLOAT, "round", step=2) == Passing(Through.STEPS, 2.0)
    assert of(FLOAT, "round", step=1).through is Through.STEPS
    assert of(SHORT, "round", step=1).through is Through.ALL
    assert of(FLOAT, "clamp", low=3, high=3).through is Through.NOTHING
    assert of(FLOAT, "clamp", low=0, high=0).through is Through.RANGE, "-0 stays"
    assert of(BYTE, "clamp", low=0, high=255).through is Through.ALL
    assert of(SHORT, "clamp", low=0, high=255).through is Through.RANGE
    assert of(FLOAT, "sort").through is Through.ALL


def test_pictures_depend_on_other_fields() -> None:
    with pytest.raises(FilterRefused, match="other fields"):
        of(BYTE, "pixelate", block=8)


def test_rooms_are_as_wide_as_the_narrowest_line() -> None:
    assert of(FLOAT, "rooms", "p.x", a=SQUARE, hysteresis=0.5).size == 4
    assert of(FLOAT, "rooms", "p.y", a=SQUARE).size == 3
    assert of(FLOAT, "rooms", "p.y", a=SQUARE, b="9 9, 10 10").size == 1
    assert of(FLOAT, "rooms", "p.x", a=CORNERED).size == 0
    assert of(FLOAT, "rooms", "p.z", a=SQUARE).through is Through.TOLD


@pytest.mark.parametrize(
    ("steps", "size"),
    [
        ([], 0),
        ([2], 2),
        ([2, 2], 2),
        ([2, 4], 4),
        ([4, 2, 8], 8),
        ([2, 3], 2),
        ([0.1, 0.3], 0.3),
        ([0.1, 0.2], 0.1),
    ],
)
def test_steps_on_steps(steps: list[float], size: float) -> None:
    for given in (steps, steps[::-1]):
        assert size_of(Passing(Through.STEPS, each) for each in given) == size


def test_other_passings_have_no_size_and_rooms_do_not_nest() -> None:
    assert size_of([Passing(Through.RANGE), Passing(Through.ALL)]) == 0
    room = Passing(Through.STEPS, 4.0, is_joint=True)
    assert size_of([room, Passing(Through.STEPS, 2.0)]) == 2
    assert size_of([room, room._replace(size=2.0)]) == 2
