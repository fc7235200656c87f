import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import Value, encode
from ca.enrollment.messages import (
    MAX_MESSAGE,
    Abort,
    Acknowledgement,
    Delivery,
    Done,
    EnrollmentOffer,
    Fetch,
    Message,
    Reason,
    frame,
    length,
    read,
    write,
)
from ca.errors import EnrollmentMessageRefused

OFFER = EnrollmentOffer((b"leaf", b"intermediate"), b"root", bytes(16), bytes(32))
MESSAGES = [
    Fetch(),
    Delivery(b"csr"),
    OFFER,
    EnrollmentOffer((b"leaf",), b"root", bytes(16), b""),
    Acknowledgement(b"statement"),
    Done(b"statement"),
    *map(Abort, Reason),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_every_message_comes_back(message: Message) -> None:
    assert read(write(message)) == message


@pytest.mark.parametrize(
    "fields",
    [
        [],
        [1],
        [1, 0],
        [1, 7],
        [1, 1, 1],
        [True, 1],
        [1, True],
        [1.0, 1],
        [1, 2],
        [1, 2, "csr"],
        [1, 3, [], b"r", bytes(16), b""],
        [1, 3, [b"a", b"b", b"c"], b"r", bytes(16), b""],
        [1, 3, [b"a", "b"], b"r", bytes(16), b""],
        [1, 3, b"a", b"r", bytes(16), b""],
        [1, 3, [b"a"], b"r", bytes(15), b""],
        [1, 3, [b"a"], b"r", bytes(16), bytes(31)],
        [1, 3, [b"a"], b"r", bytes(16), bytes(32), 1],
        [1, 4, 1],
        [1, 5, b"a", b"b"],
        [1, 6, 0],
        [1, 6, 4],
        [1, 6, True],
        "text",
        {1: 1},
    ],
    ids=repr,
)
def test_invalid_messages_are_refused(fields: Value) -> None:
    with pytest.raises(EnrollmentMessageRefused, match="not a message of the enrollment"):
        read(encode(fields))


def test_another_version_says_so() -> None:
    with pytest.raises(EnrollmentMessageRefused, match="uses version 2") as caught:
        read(encode([2, 1]))
    assert "update" in caught.value.hint


def test_size_comes_first() -> None:
    with pytest.raises(EnrollmentMessageRefused, match="at most 8192"):
        read(bytes(MAX_MESSAGE + 1))


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_every_truncation_and_a_tail(message: Message) -> None:
    data = write(message)
    for flawed in (*(data[:size] for size in range(len(data))), data + b"\0"):
        with pytest.raises(EnrollmentMessageRefused):
            read(flawed)


@given(st.binary(max_size=200))
def test_what_is_read_was_written_so(data: bytes) -> None:
    try:
        message = read(data)
    except EnrollmentMessageRefused:
        return
    assert write(message) == data


def test_a_frame_begins_with_its_length() -> None:
    framed = frame(b"abc")
    assert framed == b"\0\0\0\x03abc"
    assert length(framed[:4]) == 3
    assert length(MAX_MESSAGE.to_bytes(4)) == MAX_MESSAGE


@pytest.mark.parametrize("size", [0, MAX_MESSAGE + 1, (1 << 32) - 1])
def test_lengths_no_message_has(size: int) -> None:
    with pytest.raises(EnrollmentMessageRefused, match=f"a message of {size} octets"):
        length(size.to_bytes(4))
