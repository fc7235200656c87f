"""The messages of an enrollment and the codec and machine of both modes, enrollment and join.

A message is a deterministic CBOR array behind a length of four octets: the version, a number, its
fields. Messages are untrusted here: the state machines authenticate them.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any, Final, Generic, TypeAlias, TypeVar

from ca.certificates import TrustAnchor
from ca.encoding import Value, decode, encode
from ca.enrollment import NONCE_SIZE
from ca.errors import CAError, EncodingError, EnrollmentMessageRefused, EnrollmentOver, EnrollmentRefused
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
    csr: bytes


@dataclass(frozen=True)
class EnrollmentOffer:
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
    reason: Reason


Message: TypeAlias = Fetch | Delivery | EnrollmentOffer | Acknowledgement | Done | Abort
_State = TypeVar("_State", bound=Enum)
_Message = TypeVar("_Message")
_Reader: TypeAlias = Callable[[Any], Any]  # of one field: raises `ValueError` for what it cannot be


def octets(most: int = MAX_MESSAGE, least: int = 0) -> _Reader:
    def read(item: object) -> bytes:
        if not isinstance(item, bytes) or not least <= len(item) <= most:
            raise ValueError("not a byte string of this size")
        return item

    return read


def text(most: int) -> _Reader:
    def read(item: object) -> str:
        if not isinstance(item, str) or len(item) > most:
            raise ValueError("not a text of this size")
        return item

    return read


def chain(items: object) -> tuple[bytes, ...]:
    certificates = tuple(items) if isinstance(items, list) else ()
    if not 0 < len(certificates) <= MAX_CHAIN or not all(isinstance(each, bytes) for each in certificates):
        raise ValueError("not a chain")
    return certificates


def _tag(item: object) -> bytes:
    found: bytes = octets(TAG_SIZE)(item)
    if len(found) not in {0, TAG_SIZE}:
        raise ValueError("not a tag")
    return found


NONCE: Final = octets(NONCE_SIZE, NONCE_SIZE)


class Codec(Generic[_Message]):
    """The messages of one mode: each its class and the readers of its fields, numbered from `first` on."""

    def __init__(self, mode: str, first: int, *forms: tuple[Any, ...]) -> None:
        self._mode = mode
        self._forms = dict(enumerate(forms, first))
        self._numbers = {form[0]: number for number, form in self._forms.items()}

    def write(self, message: _Message) -> bytes:
        items: list[Value] = [VERSION, self._numbers[type(message)]]
        for name, value in vars(message).items():
            if value == getattr(type(message), name, None):
                continue  # the default of a last field is left out
            items.append([*value] if isinstance(value, tuple) else value)
        return encode([int(item) if isinstance(item, IntEnum) else item for item in items])

    def read(self, data: bytes) -> _Message:
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
            case [_, int() as number, *items] if len(items) < len(self._forms.get(number, ())):
                kind, *readers = self._forms[number]
                with suppress(TypeError, ValueError):  # a field that is missing, or of another form
                    message: _Message = kind(
                        *(take(item) for take, item in zip(readers, items, strict=False))
                    )
                    if self.write(message) == data:  # True == 1, but it has another encoding
                        return message
        raise EnrollmentMessageRefused(f"not a message of {self._mode}")


_CODEC: Final = Codec[Message](
    "the enrollment",
    1,
    (Fetch,),
    (Delivery, octets()),
    (EnrollmentOffer, chain, octets(), NONCE, _tag),
    (Acknowledgement, octets()),
    (Done, octets()),
    (Abort, Reason),
)
write, read = _CODEC.write, _CODEC.read


def frame(message: bytes) -> bytes:
    return len(message).to_bytes(HEADER_SIZE) + message


def length(header: bytes) -> int:
    # Before anything is received: a stranger says how much memory a message takes.
    size = int.from_bytes(header)
    if not 0 < size <= MAX_MESSAGE:
        raise EnrollmentMessageRefused(f"a message of {size} octets where 1 to {MAX_MESSAGE} are allowed")
    return size


class Machine(Generic[_State]):
    """One side of a session: `table` has all transitions that a message causes, any other is refused.

    An entry is the method that takes the message, and the states in which it may leave the machine.
    """

    def __init__(
        self, state: _State, table: Mapping[tuple[_State, type[Any]], tuple[str, tuple[_State, ...]]]
    ) -> None:
        self.state = state
        self._table = table

    def _take(self, message: object, *more: object) -> Any:
        entry = self._table.get((self.state, type(message)))
        if entry is None:
            raise EnrollmentMessageRefused(
                f"unexpected {type(message).__name__} in state {self.state.value!r}"
            )
        method, followers = entry
        result = getattr(self, method)(message, *more)
        assert self.state in followers  # noqa: S101 - the table is the truth
        return result

    def _require(self, *states: _State) -> None:
        if self.state not in states:
            raise EnrollmentOver(f"not possible in state {self.state.value!r}")


def given(value: _Message | None, missing: str, hint: str = "") -> _Message:
    if value is None:
        raise EnrollmentOver(missing, hint)
    return value


def check_nonce(nonce: bytes) -> bytes:
    if len(nonce) != NONCE_SIZE:
        raise EnrollmentRefused(f"a nonce has {NONCE_SIZE} octets")
    return nonce


def check_issued(root: bytes, chain: Sequence[bytes], own: IdentityRequest, now: int) -> TrustAnchor:
    """The anchor in `root`, if `chain` is the identity that was asked for with `own`, under it."""
    try:
        anchor = TrustAnchor.load(root)
        identity = anchor.verify(chain, now)
    except CAError as error:
        raise EnrollmentRefused(f"invalid offer: {error}", error.hint) from error
    # The key first: an identity of the right name for another key would be somebody else's.
    if identity.thumbprint != own.thumbprint:
        raise EnrollmentRefused("an identity for another key")
    offered = (identity.domain, identity.name, identity.wildcard)
    if offered != (own.domain, own.name, own.wildcard):
        raise EnrollmentRefused("an identity for another name than the one asked for")
    return anchor
