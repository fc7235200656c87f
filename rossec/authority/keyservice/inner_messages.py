"""Messages between the service and its network face: bytes to values and back. Pure.

Frames as in `messages`, of deterministic CBOR. `[0, number, operation, argument...]` is a request,
`[1, number, value]` its answer, `[2, number, message, hint]` a refusal. Each side numbers its own
requests. `OPERATIONS` is all that the two may ask of each other: what strangers send reaches the
service as the octets of one `join` or `name`, of a fixed layout and bounded
(`ca.enrollment.join_request`, `join_claim`).
"""

from collections.abc import Mapping
from typing import Final, NamedTuple, TypeAlias

from ca.encoding import Value, decode, encode
from ca.enrollment.join_claim import MAX_SIZE as MAX_CLAIM
from ca.enrollment.join_request import MAX_SIZE as MAX_JOIN
from ca.errors import EncodingError
from ca.revocation.tree import MAX_TREE_ENTRIES_SIZE
from rossec.authority.keyservice.messages import HEAD
from rossec.errors import KeyMessageRefused

MAX_FROM_FACE: Final = 1024 * 1024  # the master answers so much at most
MAX_FROM_SERVICE: Final = MAX_TREE_ENTRIES_SIZE + 64 * 1024
MAX_NUMBER: Final = 1 << 32

READY, FAILED, JOIN, NAME, CALL = "ready", "failed", "join", "name", "call"
OPERATIONS: Final[Mapping[str, tuple[type, ...]]] = {
    READY: (int,),  # from the face: it listens on this port; 0: on none
    FAILED: (str, str),  # from the face: it cannot; message and hint
    JOIN: (bytes,),  # from the face: a node's request; answered with a message for the node
    NAME: (bytes,),  # from the face: a node's claim; answered with a message for the node
    CALL: (str, list, int),  # from the service: method, arguments, seconds; the master's answer
}


class InnerRequest(NamedTuple):
    """A request of the other side, whose arguments have the types of `OPERATIONS`."""

    number: int
    operation: str
    arguments: tuple[Value, ...]


class InnerAnswer(NamedTuple):
    """The answer to a request of this side."""

    number: int
    value: Value


class InnerRefusal(NamedTuple):
    """A request of this side that was refused."""

    number: int
    message: str
    hint: str


InnerMessage: TypeAlias = InnerRequest | InnerAnswer | InnerRefusal


def write(message: InnerMessage) -> bytes:
    """The frame of a message.

    Raises:
        EncodingError: a value that CBOR messages cannot hold here.
    """
    match message:
        case InnerRequest(number, operation, arguments):
            body = encode([0, number, operation, *arguments])
        case InnerAnswer(number, value):
            body = encode([1, number, value])
        case _:
            body = encode([2, *message])
    return len(body).to_bytes(HEAD) + body


def read(body: bytes, limit: int) -> InnerMessage:
    """Read the body of a frame.

    Raises:
        KeyMessageRefused: malformed, or not in the table of operations.
    """
    try:
        value = decode(body, limit=limit)
    except EncodingError as error:
        raise KeyMessageRefused(f"a message that is malformed: {error}") from error
    match value:
        case [int() as kind, int() as number, *rest] if (
            type(kind) is int and type(number) is int and 0 <= number < MAX_NUMBER
        ):
            found = _message(kind, number, rest)
            if found is not None:
                return found
    raise KeyMessageRefused("a message that is not in the table of operations")


def _message(kind: int, number: int, rest: list[Value]) -> InnerMessage | None:
    match kind, rest:
        case 0, [str() as operation, *arguments] if operation in OPERATIONS:
            if tuple(map(type, arguments)) == OPERATIONS[operation] and _fits(operation, arguments):
                return InnerRequest(number, operation, tuple(arguments))
        case 1, [value]:
            return InnerAnswer(number, value)
        case 2, [str() as message, str() as hint]:
            return InnerRefusal(number, message, hint)
        case _:
            pass
    return None


def _fits(operation: str, arguments: list[Value]) -> bool:
    match operation, arguments:
        case "join", [bytes() as request]:
            return len(request) <= MAX_JOIN
        case "name", [bytes() as claim]:
            return len(claim) <= MAX_CLAIM
        case "ready", [int() as port]:
            return 0 <= port < 1 << 16
        case _:
            return True
