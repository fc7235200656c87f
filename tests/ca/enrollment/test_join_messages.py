import pytest

from ca.encoding import encode
from ca.enrollment import messages
from ca.enrollment.join import (
    ClaimMessage,
    Hello,
    Issued,
    Join,
    JoinMessage,
    Named,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    Welcome,
    read,
    write,
)
from ca.errors import EnrollmentMessageRefused

ID, NONCE = bytes(range(32)), bytes(range(16))
MESSAGES: list[JoinMessage] = [
    Hello(ID, NONCE),
    Welcome(NONCE, (b"leaf",), b"root", b"statement"),
    Welcome(NONCE, (b"leaf", b"intermediate"), b"root", b"statement"),
    Join("/robot", b"csr", b"proof"),
    Issued((b"leaf",)),
    Issued((b"leaf", b"intermediate")),
    Join("/robot", b"csr", b"proof", b"<node/>"),
    ClaimMessage(b"<node/>", b"proof"),
    ClaimMessage(bytes(4096), bytes(512)),
    Named("/robot"),
    *(WaitingMessage(reason) for reason in WaitReason),
    *(RefusedMessage(reason) for reason in RefuseReason),
]


@pytest.mark.parametrize("message", MESSAGES)
def test_what_is_written_is_read(message: JoinMessage) -> None:
    data = write(message)
    assert read(data) == message
    for end in range(len(data)):
        with pytest.raises(EnrollmentMessageRefused):
            read(data[:end])
    with pytest.raises(EnrollmentMessageRefused):
        read(data + b"\0")


def test_the_forms_as_specified() -> None:
    assert write(MESSAGES[0]) == encode([1, 7, ID, NONCE])
    assert write(MESSAGES[1]) == encode([1, 8, NONCE, [b"leaf"], b"root", b"statement"])
    assert write(MESSAGES[3]) == encode([1, 9, "/robot", b"csr", b"proof"])
    assert write(MESSAGES[4]) == encode([1, 10, [b"leaf"]])
    assert write(WaitingMessage(WaitReason.PERSON)) == encode([1, 11, 2])
    assert write(RefusedMessage(RefuseReason.BUSY)) == encode([1, 12, 6])
    joined = encode([1, 9, "/robot", b"csr", b"proof", b"<node/>"])
    assert write(Join("/robot", b"csr", b"proof", b"<node/>")) == joined
    assert write(ClaimMessage(b"<node/>", b"proof")) == encode([1, 13, b"<node/>", b"proof"])
    assert write(Named("/robot")) == encode([1, 14, "/robot"])


@pytest.mark.parametrize("message", MESSAGES)
def test_no_message_is_one_of_an_enrollment(message: JoinMessage) -> None:
    with pytest.raises(EnrollmentMessageRefused):
        messages.read(write(message))


@pytest.mark.parametrize(
    "message",
    [
        messages.Fetch(),
        messages.Delivery(b"csr"),
        messages.Abort(messages.Reason.OVER),
        messages.EnrollmentOffer((b"leaf",), b"root", NONCE, b""),
    ],
)
def test_and_none_of_an_enrollment_is_one(message: messages.Message) -> None:
    with pytest.raises(EnrollmentMessageRefused):
        read(messages.write(message))


@pytest.mark.parametrize(
    "data",
    [
        encode([1, 7, ID[1:], NONCE]),
        encode([1, 7, ID, NONCE + b"\0"]),
        encode([1, 8, NONCE[1:], [b"leaf"], b"root", b"s"]),
        encode([1, 8, NONCE, [], b"root", b"s"]),
        encode([1, 8, NONCE, [b"a", b"b", b"c"], b"root", b"s"]),
        encode([1, 8, NONCE, [7], b"root", b"s"]),
        encode([1, 8, NONCE, [b"a"], b"root", bytes(513)]),
        encode([1, 9, "/robot", bytes(2049), b""]),
        encode([1, 9, "/robot", b"", bytes(513)]),
        encode([1, 9, "/" + "a" * 255, b"", b""]),
        encode([1, 9, b"/robot", b"", b""]),
        encode([1, 10, []]),
        encode([1, 10, [b"a", 1]]),
        encode([1, 11, 0]),
        encode([1, 11, 3]),
        encode([1, 11, True]),
        encode([1, 12, 0]),
        encode([1, 12, 9]),
        encode([1, 9, "/robot", b"", b"", b""]),  # metadata that are not there are left out
        encode([1, 9, "/robot", b"", b"", bytes(4097)]),
        encode([1, 9, "/robot", b"", b"", "m"]),
        encode([1, 13, 1]),
        encode([1, 13, b"", b""]),
        encode([1, 13, bytes(4097), b""]),
        encode([1, 13, b"m", bytes(513)]),
        encode([1, 14, b"/robot"]),
        encode([1, 14, "/" + "a" * 255]),
        encode([1, 15]),
        encode([True, 11, 1]),
        encode({}),
        b"\xff",
        bytes(messages.MAX_MESSAGE + 1),
    ],
)
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(EnrollmentMessageRefused):
        read(data)


def test_another_version_says_so() -> None:
    with pytest.raises(EnrollmentMessageRefused, match="version 2") as caught:
        read(encode([2, 7, ID, NONCE]))
    assert "update" in caught.value.hint
