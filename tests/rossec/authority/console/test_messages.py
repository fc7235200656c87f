"""Requests of the console: exactly those of the tables."""

import pytest

from ca.encoding import Value, encode
from rossec.authority.console import messages
from rossec.authority.console.messages import OPERATIONS, PREPARED, checked, read_request
from rossec.authority.keyservice.messages import ServiceRequest
from rossec.errors import KeyMessageRefused, KeyServiceRefused

ONE: dict[type, Value] = {bytes: b"x", str: "x", int: 1, bool: True, list: []}


@pytest.mark.parametrize("operation", sorted(OPERATIONS.keys() - {"prepare"}))
def test_read_request_takes_exactly_the_types_of_the_table(operation: str) -> None:
    arguments = [ONE[kind] for kind in OPERATIONS[operation].arguments]
    assert read_request(encode([1, operation, *arguments])) == ServiceRequest(operation, tuple(arguments))
    for wrong in ([*arguments, 1], *_changed(arguments)):
        with pytest.raises(KeyMessageRefused):
            read_request(encode([1, operation, *wrong]))


@pytest.mark.parametrize("kind", sorted(PREPARED))
def test_read_request_takes_exactly_the_types_of_a_kind(kind: str) -> None:
    arguments = [ONE[each] for each in PREPARED[kind]]
    assert read_request(encode([1, "prepare", kind, arguments, "o"])).arguments == (kind, arguments, "o")
    for wrong in ([*arguments, 1], *_changed(arguments)):
        with pytest.raises(KeyMessageRefused):
            read_request(encode([1, "prepare", kind, wrong, "o"]))


def _changed(arguments: list[Value]) -> list[list[Value]]:
    """The arguments, each once of another type; a bool is no int."""
    others: dict[type, Value] = {bytes: "x", str: b"x", int: True, bool: 1, list: "x"}
    return [
        [*arguments[:place], others[type(each)], *arguments[place + 1 :]]
        for place, each in enumerate(arguments)
    ] + [arguments[:-1]] * bool(arguments)


@pytest.mark.parametrize(
    "value",
    [
        [1, "sign", b"x"],
        [1, "unlock", 0, "x"],
        [2, "status"],
        [1],
        [],
        {},
        None,
        [1, "prepare", "all", [], ""],
        [1, "prepare", "grant", {}, ""],
        [1, "prepare", "delegate", [1, 1]],
        [True, "status"],
    ],
)
def test_read_request_refuses_what_is_not_in_the_table(value: Value) -> None:
    with pytest.raises(KeyMessageRefused):
        read_request(encode(value))


def test_read_request_refuses_every_cut_and_trailing_bytes() -> None:
    whole = encode([1, "deny-request", b"\1" * 32, "no"])
    assert read_request(whole)
    for data in (*(whole[:size] for size in range(len(whole))), whole + b"\0"):
        with pytest.raises(KeyMessageRefused):
            read_request(data)


def test_read_request_looks_at_the_size_first() -> None:
    with pytest.raises(KeyMessageRefused, match="malformed"):
        read_request(encode([1, "redeem", "x" * messages.MAX_REQUEST]))


def test_an_answer_that_is_too_long_is_a_refusal() -> None:
    assert checked(["x"]) == ["x"]
    with pytest.raises(KeyServiceRefused, match="4194304 bytes"):
        checked(bytes(messages.MAX_ANSWER))
