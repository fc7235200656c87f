"""The messages of an enrollment: deterministic CBOR arrays, each in a frame of its own.

A frame is a length of four octets and one message. Messages are untrusted here: the state machines
authenticate them.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, TypeAlias

from ca.encoding import Value, decode, encode
from ca.enrollment import NONCE_SIZE
from ca.errors import EncodingError, EnrollmentMessageRefused

VERSION: Final = 1
MAX_MESSAGE: Final = 8192  # a chain of two, a root, a nonce and a tag have at most 6300 octets
HEADER_SIZE: Final = 4
TAG_SIZE: Final = 32
MAX_CHAIN: Final = 2


class Reason(IntEnum):
    """The reason for an abort, sent to the other side. Unauthenticated, so only a hint."""

    REFUSED = 1
    OVER = 2
    CONFLICT = 3


_REASONS: Final = frozenset(Reason)


@dataclass(frozen=True)
class Fetch:
    """Authority to node: asks for the request."""


@dataclass(frozen=True)
class Delivery:
    """Node to authority: the request, a CSR in DER."""

    csr: bytes


@dataclass(frozen=True)
class Offer:
    """Authority to node: the node's identity and its trust anchor.

    `chain` is the node's certificate and at most one intermediate (DER), `root` the trust anchor.
    `tag` proves that the sender has read the code; for label codes it is empty.
    """

    chain: tuple[bytes, ...]
    root: bytes
    nonce: bytes
    tag: bytes


@dataclass(frozen=True)
class Acknowledgement:
    """Node to authority: a signed acknowledgement of the offer (`transcript`)."""

    statement: bytes


@dataclass(frozen=True)
class Done:
    """Node to authority: a signed statement that the node is enrolled (`transcript`)."""

    statement: bytes


@dataclass(frozen=True)
class Abort:
    """Either side: ends the enrollment."""

    reason: Reason


Message: TypeAlias = Fetch | Delivery | Offer | Acknowledgement | Done | Abort


def write(message: Message) -> bytes:
    """Encode one message."""
    return encode([VERSION, *_fields(message)])


def read(data: bytes) -> Message:
    """Decode one message, strictly.

    Raises:
        EnrollmentMessageRefused: too long, malformed, or of another version.
    """
    try:
        message = _message(decode(data, limit=MAX_MESSAGE))
    except EncodingError as error:
        raise EnrollmentMessageRefused(f"invalid message: {error}") from error
    if message is None or write(message) != data:  # True == 1, but it has another encoding
        raise EnrollmentMessageRefused("not a message of the enrollment")
    return message


def frame(message: bytes) -> bytes:
    """A message with its length in front."""
    return len(message).to_bytes(HEADER_SIZE) + message


def length(header: bytes) -> int:
    """The length in a frame's first four octets.

    Raises:
        EnrollmentMessageRefused: longer than any message is.
    """
    size = int.from_bytes(header)
    if not 0 < size <= MAX_MESSAGE:
        raise EnrollmentMessageRefused(
            f"a message of {size} octets where 1 to {MAX_MESSAGE} are allowed"
        )
    return size


def _fields(message: Message) -> list[Value]:
    match message:
        case Fetch():
            return [1]
        case Delivery(csr):
            return [2, csr]
        case Offer(chain, root, nonce, tag):
            return [3, list(chain), root, nonce, tag]
        case Acknowledgement(statement):
            return [4, statement]
        case Done(statement):
            return [5, statement]
        case _:
            return [6, int(message.reason)]


def _message(fields: Value) -> Message | None:
    match fields:
        case [1, 1]:
            return Fetch()
        case [1, 2, bytes() as csr]:
            return Delivery(csr)
        case [1, 3, [*chain], bytes() as root, bytes() as nonce, bytes() as tag]:
            return _offer(chain, root, nonce, tag)
        case [1, 4 | 5 as kind, bytes() as statement]:
            return Acknowledgement(statement) if kind == 4 else Done(statement)
        case [1, 6, int() as reason] if reason in _REASONS:
            return Abort(Reason(reason))
        case [int() as version, *_] if version != VERSION:
            raise EnrollmentMessageRefused(
                f"the other side uses version {version} of the enrollment",
                "update the older of the two sides",
            )
    return None


def _offer(chain: list[Value], root: bytes, nonce: bytes, tag: bytes) -> Offer | None:
    certificates = tuple(item for item in chain if isinstance(item, bytes))
    if not 0 < len(certificates) == len(chain) <= MAX_CHAIN:
        return None
    if len(nonce) != NONCE_SIZE or len(tag) not in {0, TAG_SIZE}:
        return None
    return Offer(certificates, root, nonce, tag)
