"""Messages: one encoding each, bounded before they are read, and only those of the table."""

import pytest

from ca.encoding import Value, encode
from ca.errors import HintedError, KeyRefused, PassphraseRefused
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import (
    HEAD,
    MAX_FRAME,
    REFUSALS,
    ServiceRequest,
    frame_size,
    read_answer,
    read_request,
    write_answer,
    write_refusal,
    write_request,
)
from rossec.errors import AuthorityLocked, KeyMessageRefused, KeyServiceRefused

REQUESTS = [
    ServiceRequest("status"),
    ServiceRequest("lock"),
    ServiceRequest("unlock", (900, "four random words")),
    ServiceRequest("sign", (b"to be signed",)),
]


def body(data: bytes) -> bytes:
    assert frame_size(data[:HEAD]) == len(data) - HEAD
    return data[HEAD:]


@pytest.mark.parametrize("request_", REQUESTS)
def test_a_request_is_read_as_it_was_written(request_: ServiceRequest) -> None:
    data = body(write_request(request_))
    assert read_request(data) == request_
    for changed in (*(data[:size] for size in range(len(data))), data + b"\0"):
        with pytest.raises(KeyMessageRefused):
            read_request(changed)


@pytest.mark.parametrize(
    "value",
    [
        [],
        {},
        [1],
        [2, "status"],
        [1, "format"],
        [1, "status", 1],
        [1, "unlock", 1],
        [1, "unlock", "1", "x"],
        [1, "unlock", True, "x"],
        [1, "sign", "text"],
        ["status"],
        [1, b"status"],
        1,
        [True, "status", 5],
    ],
)
def test_a_request_outside_the_table_is_refused(value: Value) -> None:
    with pytest.raises(KeyMessageRefused):
        read_request(encode(value))


def test_another_encoding_of_a_request_is_refused() -> None:
    with pytest.raises(KeyMessageRefused, match="malformed"):
        read_request(bytes.fromhex("9f01") + encode("status") + b"\xff")  # of indefinite length


@pytest.mark.parametrize("size", [0, MAX_FRAME + 1, 0xFFFFFFFF])
def test_an_empty_or_huge_frame_is_refused_unread(size: int) -> None:
    with pytest.raises(KeyMessageRefused, match="a message of"):
        frame_size(size.to_bytes(HEAD))


@pytest.mark.parametrize("value", [b"signature", {"locked": True, "remaining": None}, 5])
def test_an_answer_is_read_as_it_was_written(value: Value) -> None:
    assert read_answer(body(write_answer(value))) == value


@pytest.mark.parametrize("kind", REFUSALS.values())
def test_a_refusal_is_raised_as_what_it_is(kind: type[HintedError]) -> None:
    with pytest.raises(kind, match="what happened") as caught:
        read_answer(body(write_refusal(kind("what happened", "what to do"))))
    assert (type(caught.value), caught.value.hint) == (kind, "what to do")


def test_an_error_outside_the_table_is_a_refusal() -> None:
    with pytest.raises(KeyServiceRefused, match="another"):
        read_answer(body(write_refusal(KeyRefused("another"))))


@pytest.mark.parametrize("value", [[], [0], [0, 1, 2], [1, "other", "", ""], [1, "locked"], 7])
def test_an_answer_of_another_form_is_refused(value: Value) -> None:
    with pytest.raises(KeyMessageRefused, match="another form"):
        read_answer(encode(value))


def test_a_malformed_answer_is_refused() -> None:
    with pytest.raises(KeyMessageRefused, match="malformed"):
        read_answer(b"\xff")


def test_the_kinds_of_refusals_are_told_apart() -> None:
    assert {AuthorityLocked, PassphraseRefused} <= set(messages.REFUSALS.values())
    assert len(set(messages.REFUSALS.values())) == len(messages.REFUSALS)
