"""The messages of a join, in the frames of `ca.enrollment.messages`: deterministic CBOR arrays.

Their numbers continue those of an enrollment, so that no message of one mode is one of the other.
Messages are untrusted here: the state machines authenticate them. `Issued`, `Waiting` and `Refused`
are the answers: what the authority's side decides, and all that a node is told.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, TypeAlias

from ca.encoding import Value, decode, encode
from ca.enrollment import NONCE_SIZE
from ca.enrollment.invitation import ID_SIZE
from ca.enrollment.join_transcript import MAX_STATEMENT
from ca.enrollment.messages import MAX_CHAIN, MAX_MESSAGE, VERSION
from ca.errors import EncodingError, EnrollmentMessageRefused
from ca.names import MAX_NAME
from ca.requests import MAX_REQUEST


class WaitReason(IntEnum):
    """Why a request waits."""

    LOCKED = 1
    PERSON = 2


class RefuseReason(IntEnum):
    """Why a join was refused. A peer that did not prove the secret is told the first or the last.

    REFUSED: no such invitation, or the proof is wrong; ENDED: it has expired, was ended or is used
    up; NAME: it does not allow the name; REQUEST: the request is invalid; DENIED: a person denied
    it, or its key is revoked; BUSY: too many at once.
    """

    REFUSED = 1
    ENDED = 2
    NAME = 3
    REQUEST = 4
    DENIED = 5
    BUSY = 6


_WAITS: Final = frozenset(WaitReason)
_REFUSALS: Final = frozenset(RefuseReason)


@dataclass(frozen=True)
class Hello:
    """Node to authority: the id of the invitation, and a fresh nonce."""

    invitation: bytes
    nonce: bytes


@dataclass(frozen=True)
class Welcome:
    """Authority to node: a fresh nonce, the chain of `/ca`, its root, and its signed transcript."""

    nonce: bytes
    chain: tuple[bytes, ...]
    root: bytes
    statement: bytes


@dataclass(frozen=True)
class Join:
    """Node to authority: the name, the request (CSR, DER), and the proof of the secret."""

    name: str
    csr: bytes
    proof: bytes


@dataclass(frozen=True)
class Issued:
    """Authority to node: its certificate, and an intermediate's if there is one (DER)."""

    chain: tuple[bytes, ...]


@dataclass(frozen=True)
class Waiting:
    """Authority to node: not yet; the same request may be sent again."""

    reason: WaitReason


@dataclass(frozen=True)
class Refused:
    """Authority to node: no."""

    reason: RefuseReason


JoinAnswer: TypeAlias = Issued | Waiting | Refused
JoinMessage: TypeAlias = Hello | Welcome | Join | JoinAnswer


def write(message: JoinMessage) -> bytes:
    """Encode one message."""
    return encode([VERSION, *_fields(message)])


def read(data: bytes) -> JoinMessage:
    """Decode one message, strictly.

    Raises:
        EnrollmentMessageRefused: too long, malformed, or of another version.
    """
    try:
        message = _message(decode(data, limit=MAX_MESSAGE))
    except EncodingError as error:
        raise EnrollmentMessageRefused(f"invalid message: {error}") from error
    if message is None or write(message) != data:  # True == 1, but it has another encoding
        raise EnrollmentMessageRefused("not a message of a join")
    return message


def _fields(message: JoinMessage) -> list[Value]:
    match message:
        case Hello(invitation, nonce):
            return [7, invitation, nonce]
        case Welcome(nonce, chain, root, statement):
            return [8, nonce, list(chain), root, statement]
        case Join(name, csr, proof):
            return [9, name, csr, proof]
        case Issued(chain):
            return [10, list(chain)]
        case Waiting(reason):
            return [11, int(reason)]
        case _:
            return [12, int(message.reason)]


def _message(fields: Value) -> JoinMessage | None:
    match fields:
        case [1, 7, bytes() as invitation, bytes() as nonce] if len(invitation) == ID_SIZE:
            return Hello(invitation, nonce) if len(nonce) == NONCE_SIZE else None
        case [1, 8, bytes() as nonce, [*chain], bytes() as root, bytes() as statement]:
            return _welcome(nonce, _chain(chain), root, statement)
        case [1, 9, str() as name, bytes() as csr, bytes() as proof]:
            fits = len(name) <= MAX_NAME and len(csr) <= MAX_REQUEST and len(proof) <= MAX_STATEMENT
            return Join(name, csr, proof) if fits else None
        case [int() as version, *_] if version != VERSION:
            raise EnrollmentMessageRefused(
                f"the other side uses version {version} of the enrollment",
                "update the older of the two sides",
            )
    return _answer(fields)


def _answer(fields: Value) -> JoinAnswer | None:
    match fields:
        case [1, 10, [*items]]:
            return None if (issued := _chain(items)) is None else Issued(issued)
        case [1, 11, int() as reason] if reason in _WAITS:
            return Waiting(WaitReason(reason))
        case [1, 12, int() as reason] if reason in _REFUSALS:
            return Refused(RefuseReason(reason))
    return None


def _welcome(
    nonce: bytes, chain: tuple[bytes, ...] | None, root: bytes, statement: bytes
) -> Welcome | None:
    if chain is None or len(nonce) != NONCE_SIZE or len(statement) > MAX_STATEMENT:
        return None
    return Welcome(nonce, chain, root, statement)


def _chain(items: list[Value]) -> tuple[bytes, ...] | None:
    certificates = tuple(item for item in items if isinstance(item, bytes))
    return certificates if 0 < len(certificates) == len(items) <= MAX_CHAIN else None
