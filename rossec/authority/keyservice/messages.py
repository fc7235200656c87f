"""Messages to the authority's service and its answers: bytes to values and back. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR
(`ca.encoding`). A request is `[1, operation, argument...]`: 1 is the version, `OPERATIONS` says
which arguments an operation has. An answer is `[0, value]`, or `[1, kind, message, hint]` for a
refusal, whose kind is in `REFUSALS`. The length is checked before anything is read.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, HintedError, PassphraseRefused, TokenRefused
from rossec.authority.keyservice.recognize import MAX_MESSAGE
from rossec.errors import (
    AuthorityLocked,
    KeyMessageRefused,
    KeyServiceRefused,
    PhoneCodeRefused,
    SigningRefused,
)

SOCKET: Final = "service.sock"  # in the authority's directory
VERSION: Final = 1
HEAD: Final = 4
MAX_FRAME: Final = MAX_MESSAGE + 64
MAX_PASSPHRASE: Final = 4096
MAX_UNLOCKED: Final = 7 * 86400  # seconds; 0: while the service runs

STATUS, UNLOCK, LOCK, SIGN = "status", "unlock", "lock", "sign"
PHONE_CODE: Final = "phone-code"
OPERATIONS: Final[Mapping[str, tuple[type, ...]]] = {
    STATUS: (),
    UNLOCK: (int, str),  # seconds, passphrase or PIN
    LOCK: (),
    SIGN: (bytes,),  # what `Signer.sign` gets
    PHONE_CODE: (),  # a one-time code, text: to look at the console, or to add a phone
}
REFUSALS: Final[Mapping[str, type[HintedError]]] = {
    "locked": AuthorityLocked,
    "unknown": SigningRefused,
    "passphrase": PassphraseRefused,
    "token": TokenRefused,
    "code": PhoneCodeRefused,
    "refused": KeyServiceRefused,
    "malformed": KeyMessageRefused,
}
_HINT: Final = "are the service and the command of one version of rossec?"


class Request(NamedTuple):
    """An operation and its arguments, whose types are those of `OPERATIONS`."""

    operation: str
    arguments: tuple[Value, ...] = ()


def frame(value: Value) -> bytes:
    """The frame of a message."""
    body = encode(value)
    return len(body).to_bytes(HEAD) + body


def frame_size(head: bytes, limit: int = MAX_FRAME) -> int:
    """The number of bytes that follow the head of a frame.

    Raises:
        KeyMessageRefused: none, or more than `limit`.
    """
    size = int.from_bytes(head)
    if not 0 < size <= limit:
        raise KeyMessageRefused(f"a message of {size} bytes where 1 to {limit} are allowed", _HINT)
    return size


def write_request(request: Request) -> bytes:
    """The frame of a request."""
    return frame([VERSION, request.operation, *request.arguments])


def read_request(
    body: bytes,
    operations: Mapping[str, tuple[type, ...]] = OPERATIONS,
    limit: int = MAX_FRAME,
) -> Request:
    """Read the body of a request's frame, for the table `operations`.

    Raises:
        KeyMessageRefused: malformed, another version, or not an operation with its arguments.
    """
    match _decode(body, limit):
        case [version, str() as operation, *arguments] if operation in operations:
            if (
                type(version) is int
                and version == VERSION
                and tuple(map(type, arguments)) == operations[operation]
            ):
                return Request(operation, tuple(arguments))
    raise KeyMessageRefused("a request that is not in the table of operations", _HINT)


def write_answer(value: Value) -> bytes:
    """The frame of an answer."""
    return frame([0, value])


def write_refusal(error: HintedError) -> bytes:
    """The frame of a refusal; an error that is not in the table is `refused`."""
    kinds = {refusal: kind for kind, refusal in REFUSALS.items()}
    return frame([1, kinds.get(type(error), "refused"), str(error), error.hint])


def read_answer(body: bytes, limit: int = MAX_FRAME) -> Value:
    """Read the body of an answer's frame.

    Raises:
        HintedError: the refusal that the answer is, as one of `REFUSALS`.
        KeyMessageRefused: malformed.
    """
    match _decode(body, limit):
        case [0, value]:
            return value
        case [1, str() as kind, str() as message, str() as hint] if kind in REFUSALS:
            raise REFUSALS[kind](message, hint)
    raise KeyMessageRefused("an answer of another form", _HINT)


def _decode(body: bytes, limit: int) -> Value:
    try:
        return decode(body, limit=limit)
    except EncodingError as error:
        raise KeyMessageRefused(f"a message that is malformed: {error}", _HINT) from error
