"""Between the service and its face: only what is in the table, in one encoding, of bounded size."""

import pytest

from ca.encoding import Value, encode
from ca.enrollment.invitation import MAX_CLAIM_SIZE as MAX_CLAIM
from ca.enrollment.invitation import MAX_REQUEST_SIZE
from rossec.authority.keyservice.messages import (
    HEAD,
    MAX_FROM_FACE,
    InnerAnswer,
    InnerMessage,
    InnerRefusal,
    InnerRequest,
    read,
    write,
)
from rossec.errors import KeyMessageRefused

GOOD: list[InnerMessage] = [
    InnerRequest(0, "ready", (11318,)),
    InnerRequest(1, "failed", ("cannot listen", "choose another port")),
    InnerRequest(2, "join", (b"j" * MAX_REQUEST_SIZE,)),
    InnerRequest(2, "name", (b"n" * MAX_CLAIM,)),
    InnerRequest(3, "call", ("rossec.depositGrants", [[b"grant"]], 15)),
    InnerAnswer(4, None),
    InnerAnswer(5, ["", "refused"]),
    InnerRefusal(6, "not now", "later"),
]


@pytest.mark.parametrize("message", GOOD)
def test_a_message_is_read_as_it_was_written(message: InnerMessage) -> None:
    data = write(message)
    assert int.from_bytes(data[:HEAD]) == len(data) - HEAD
    assert read(data[HEAD:], MAX_FROM_FACE) == message
    for changed in (data[HEAD:-1], data[HEAD:] + b"\0", b""):
        with pytest.raises(KeyMessageRefused):
            read(changed, MAX_FROM_FACE)


@pytest.mark.parametrize(
    "value",
    [
        [],
        {},
        0,
        [0],
        [0, 1],
        [0, 1, "sign", b"x"],
        [0, 1, "unlock", 0, "x"],
        [0, 1, "join", "x"],
        [0, 1, "name", "x"],
        [0, 1, "name", b"n" * (MAX_CLAIM + 1)],
        [0, 1, "join", b"j" * (MAX_REQUEST_SIZE + 1)],
        [0, 1, "join"],
        [0, 1, "join", b"", b""],
        [0, 1, "ready", -1],
        [0, 1, "ready", 1 << 16],
        [0, 1, "ready", True],
        [0, -1, "ready", 1],
        [0, 1 << 32, "ready", 1],
        [0, "1", "ready", 1],
        [False, 1, "ready", 1],
        [0, 1, "call", "m", b"x", 1],
        [1, 2],
        [1, 2, 3, 4],
        [2, 1, "m"],
        [2, 1, "m", b"h"],
        [3, 1, 1],
    ],
)
def test_what_is_not_in_the_table_is_refused(value: Value) -> None:
    with pytest.raises(KeyMessageRefused, match="not in the table"):
        read(encode(value), MAX_FROM_FACE)


def test_more_than_the_limit_is_refused() -> None:
    data = write(InnerAnswer(1, b"x" * 100))[HEAD:]
    with pytest.raises(KeyMessageRefused, match="at most 50"):
        read(data, 50)
