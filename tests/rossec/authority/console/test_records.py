"""Records there and back, and everything that is none refused."""

from typing import NamedTuple

import pytest

from ca.encoding import Value, decode, encode
from rossec.authority.console import messages
from rossec.authority.console.messages import from_value, to_value
from rossec.errors import KeyMessageRefused
from tests.support.consoleservice import FakeHome
from tests.support.consolework import many


class Inner(NamedTuple):
    number: int
    is_on: bool


class Outer(NamedTuple):
    name: str
    data: bytes
    maybe: int | None
    items: tuple[Inner, ...]
    texts: tuple[str, ...]


OUTER = Outer("x", b"y", None, (Inner(1, True), Inner(2, False)), ("a", ""))
VALUE: list[Value] = ["x", b"y", None, [[1, True], [2, False]], ["a", ""]]


def test_a_record_is_the_list_of_its_fields() -> None:
    assert to_value(OUTER) == VALUE
    assert from_value(Outer, VALUE) == OUTER
    assert from_value(Outer, [*VALUE[:2], 7, *VALUE[3:]]) == OUTER._replace(maybe=7)
    assert many(Inner, [[1, True]]) == (Inner(1, True),)
    assert many(Inner, []) == ()
    assert from_value(str, "x") == "x"


@pytest.mark.parametrize(
    "value",
    [
        [],
        VALUE[:-1],
        [*VALUE, 1],
        "x",
        None,
        {},
        ["x", "y", *VALUE[2:]],
        [1, *VALUE[1:]],
        [*VALUE[:2], "7", *VALUE[3:]],
        [*VALUE[:2], True, *VALUE[3:]],
        [*VALUE[:3], [[1, 1]], []],
        [*VALUE[:3], [[True, True]], []],
        [*VALUE[:3], [[1]], []],
        [*VALUE[:3], [], [1]],
        [*VALUE[:3], {}, []],
        [*VALUE[:3], None, []],
        [None, *VALUE[1:]],
        [*VALUE[:3], [], "ab"],
    ],
)
def test_from_value_refuses_every_other_type(value: Value) -> None:
    with pytest.raises(KeyMessageRefused):
        from_value(Outer, value)


@pytest.mark.parametrize("value", [None, "x", {}, [1], [[1, True], None]])
def test_many_refuses_what_is_no_list_of_records(value: Value) -> None:
    with pytest.raises(KeyMessageRefused):
        many(Inner, value)


@pytest.mark.parametrize("item", [1.5, [1], {}, object(), (1, [2])])
def test_to_value_takes_only_what_records_hold(item: object) -> None:
    with pytest.raises(TypeError):
        to_value(item)


def test_every_view_survives_its_encoding() -> None:
    home = FakeHome()
    found = (
        *home.nodes,
        *home.grants,
        *home.requests,
        *home.questions,
        *home.invitations,
        *home.phones,
        *home.proposals,
        *home.approvals,
        *home.events,
        *home.denials,
        *home.graph,
        home.policy,
        home.trust_status,
    )
    for view in found:
        assert from_value(type(view), decode(encode(to_value(view)))) == view
    shown = {type(view).__name__ for view in found}
    assert {"NodeView", "GrantQuestion", "PolicyView", "ListProgress"} <= shown <= vars(messages).keys()
