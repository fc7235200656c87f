"""The messages of an enrollment: deterministic CBOR arrays, each behind a length of four octets.

Messages are untrusted here: the state machines authenticate them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final, TypeAlias, TypeVar

from ca.certificates import TrustAnchor
from ca.encoding import Value, decode, encode
from ca.enrollment import NONCE_SIZE
from ca.errors import CAError, EncodingError, EnrollmentMessageRefused, EnrollmentRefused
from ca.svid import IdentityRequest

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


@dataclass(frozen=True)
class Fetch:
    """Authority to node: asks for the request."""


@dataclass(frozen=True)
class Delivery:
    """Node to authority: the request, a CSR in DER."""

    csr: bytes


@dataclass(frozen=True)
class EnrollmentOffer:
    """Authority to node: the node's identity and its trust anchor."""

    chain: tuple[bytes, ...]  # the node's certificate and at most one intermediate (DER)
    root: bytes
    nonce: bytes
    tag: bytes  # proves that the sender has read the code; empty for label codes


@dataclass(frozen=True)
class Acknowledgement:
    statement: bytes


@dataclass(frozen=True)
class Done:
    statement: bytes


@dataclass(frozen=True)
class Abort:
    """Either side: ends the enrollment."""

    reason: Reason


_State = TypeVar("_State", bound=Enum)
_Message = TypeVar("_Message")
_Entry = TypeVar("_Entry")
Message: TypeAlias = Fetch | Delivery | EnrollmentOffer | Acknowledgement | Done | Abort


_KINDS: Final = (Fetch, Delivery, EnrollmentOffer, Acknowledgement, Done, Abort)
_NUMBERS: Final[dict[type[Message], int]] = {kind: number for number, kind in enumerate(_KINDS, 1)}


def write(message: Message) -> bytes:
    return encode([VERSION, _NUMBERS[type(message)], *fields_of(message)])


def read(data: bytes) -> Message:
    message = _message(read_fields(data))
    if message is None or write(message) != data:  # True == 1, but it has another encoding
        raise EnrollmentMessageRefused("not a message of the enrollment")
    return message


def read_fields(data: bytes) -> Value:
    """The items of a message of this version, of whichever mode."""
    try:
        fields = decode(data, limit=MAX_MESSAGE)
    except EncodingError as error:
        raise EnrollmentMessageRefused(f"invalid message: {error}") from error
    match fields:
        case [int() as version, *_] if version != VERSION:
            raise EnrollmentMessageRefused(
                f"the other side uses version {version} of the enrollment",
                "update the older of the two sides",
            )
    return fields


def frame(message: bytes) -> bytes:
    return len(message).to_bytes(HEADER_SIZE) + message


def length(header: bytes) -> int:
    size = int.from_bytes(header)
    if not 0 < size <= MAX_MESSAGE:
        raise EnrollmentMessageRefused(f"a message of {size} octets where 1 to {MAX_MESSAGE} are allowed")
    return size


def fields_of(message: object) -> list[Value]:
    """The fields of a message, in their order, as items."""
    fields: list[Value] = []
    for field in vars(message).values():
        match field:
            case IntEnum():
                fields.append(int(field))
            case tuple():
                fields.append([*field])
            case _:
                fields.append(field)
    return fields


def _message(fields: Value) -> Message | None:
    match fields:
        case [1, 1]:
            return Fetch()
        case [1, 2, bytes() as csr]:
            return Delivery(csr)
        case [1, 3, [*chain], bytes() as root, bytes() as nonce, bytes() as tag]:
            certificates = read_chain(chain)
            if certificates and len(nonce) == NONCE_SIZE and len(tag) in {0, TAG_SIZE}:
                return EnrollmentOffer(certificates, root, nonce, tag)
        case [1, 4 | 5 as kind, bytes() as statement]:
            return Acknowledgement(statement) if kind == 4 else Done(statement)
        case [1, 6, int() as reason] if reason in frozenset(Reason):
            return Abort(Reason(reason))
    return None


def read_chain(items: list[Value]) -> tuple[bytes, ...] | None:
    certificates = tuple(item for item in items if isinstance(item, bytes))
    return certificates if 0 < len(certificates) == len(items) <= MAX_CHAIN else None


def transition(
    table: Mapping[tuple[_State, type[_Message]], _Entry], state: _State, message: _Message
) -> _Entry:
    """What `table` says of this message in this state; any other is refused."""
    entry = table.get((state, type(message)))
    if entry is None:
        raise EnrollmentMessageRefused(f"unexpected {type(message).__name__} in state {state.value!r}")
    return entry


def check_issued(root: bytes, chain: Sequence[bytes], own: IdentityRequest, now: int) -> TrustAnchor:
    """The anchor in `root`, if `chain` is the identity that was asked for with `own`, under it."""
    try:
        anchor = TrustAnchor.load(root)
        identity = anchor.verify(chain, now)
    except CAError as error:
        raise EnrollmentRefused(f"invalid offer: {error}", error.hint) from error
    if identity.thumbprint != own.thumbprint:
        raise EnrollmentRefused("an identity for another key")
    offered = (identity.domain, identity.name, identity.wildcard)
    if offered != (own.domain, own.name, own.wildcard):
        raise EnrollmentRefused("an identity for another name than the one asked for")
    return anchor
