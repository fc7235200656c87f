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
from ca.enrollment.join_transcript import MAX_METADATA, MAX_STATEMENT
from ca.enrollment.messages import MAX_CHAIN, MAX_MESSAGE, VERSION
from ca.errors import EncodingError, EnrollmentMessageRefused
from ca.names import MAX_NAME
from ca.requests import MAX_REQUEST


class WaitReason(IntEnum):
    """Why a request waits."""

    LOCKED = 1
    PERSON = 2


class RefuseReason(IntEnum):
    """Why a join was refused. A peer that did not prove the secret is told REFUSED or BUSY.

    REFUSED: no such invitation, or the proof is wrong; ENDED: it has expired, was ended or is used
    up; NAME: it does not allow the name; REQUEST: the request is invalid; DENIED: a person denied
    it, or its key is revoked; BUSY: too many at once. Only where there are metadata: UNNAMED: the
    authority has no rules for names; METADATA: its rules give no name for them.
    """

    REFUSED = 1
    ENDED = 2
    NAME = 3
    REQUEST = 4
    DENIED = 5
    BUSY = 6
    UNNAMED = 7
    METADATA = 8


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
    """Node to authority: the name, the request (CSR, DER), and the proof of the secret.

    With `metadata` the authority issues only the name that its rules give for them.
    """

    name: str
    csr: bytes
    proof: bytes
    metadata: bytes = b""


@dataclass(frozen=True)
class Claim:
    """Node to authority: its metadata, to be told its name, and the proof of the secret."""

    metadata: bytes
    proof: bytes


@dataclass(frozen=True)
class Named:
    """Authority to node: the name that the rules give for its metadata."""

    name: str


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
NameAnswer: TypeAlias = Named | Refused
JoinMessage: TypeAlias = Hello | Welcome | Join | Claim | Named | JoinAnswer


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
        case Join(name, csr, proof, metadata):
            return [9, name, csr, proof, *([metadata] if metadata else [])]
        case Claim(metadata, proof):
            return [13, metadata, proof]
        case _:
            return _answer_fields(message)


def _answer_fields(answer: JoinAnswer | Named) -> list[Value]:
    match answer:
        case Issued(chain):
            return [10, list(chain)]
        case Waiting(reason):
            return [11, int(reason)]
        case Refused(reason):
            return [12, int(reason)]
        case Named(name):
            return [14, name]


def _message(fields: Value) -> JoinMessage | None:
    match fields:
        case [1, 7, bytes() as invitation, bytes() as nonce] if len(invitation) == ID_SIZE:
            return Hello(invitation, nonce) if len(nonce) == NONCE_SIZE else None
        case [1, 8, bytes() as nonce, [*chain], bytes() as root, bytes() as statement]:
            return _welcome(nonce, _chain(chain), root, statement)
        case [1, 9, str() as name, bytes() as csr, bytes() as proof]:
            return _fitting(Join(name, csr, proof))
        case [1, 9, str() as name, bytes() as csr, bytes() as proof, bytes() as metadata]:
            return _fitting(Join(name, csr, proof, metadata))
        case [int() as version, *_] if version != VERSION:
            raise EnrollmentMessageRefused(
                f"the other side uses version {version} of the enrollment",
                "update the older of the two sides",
            )
    return _claim(fields) or _answer(fields)


def _claim(fields: Value) -> Claim | Named | None:
    match fields:
        case [1, 13, bytes() as metadata, bytes() as proof]:
            fits = 0 < len(metadata) <= MAX_METADATA and len(proof) <= MAX_STATEMENT
            return Claim(metadata, proof) if fits else None
        case [1, 14, str() as name]:
            return Named(name) if len(name) <= MAX_NAME else None
        case _:
            return None


def _answer(fields: Value) -> JoinAnswer | None:
    match fields:
        case [1, 10, [*items]]:
            return None if (issued := _chain(items)) is None else Issued(issued)
        case [1, 11, int() as reason] if reason in _WAITS:
            return Waiting(WaitReason(reason))
        case [1, 12, int() as reason] if reason in _REFUSALS:
            return Refused(RefuseReason(reason))
    return None


def _fitting(join: Join) -> Join | None:
    fits = (
        len(join.name) <= MAX_NAME
        and len(join.csr) <= MAX_REQUEST
        and len(join.proof) <= MAX_STATEMENT
        and len(join.metadata) <= MAX_METADATA
    )
    return join if fits else None


def _welcome(
    nonce: bytes, chain: tuple[bytes, ...] | None, root: bytes, statement: bytes
) -> Welcome | None:
    if chain is None or len(nonce) != NONCE_SIZE or len(statement) > MAX_STATEMENT:
        return None
    return Welcome(nonce, chain, root, statement)


def _chain(items: list[Value]) -> tuple[bytes, ...] | None:
    certificates = tuple(item for item in items if isinstance(item, bytes))
    return certificates if 0 < len(certificates) == len(items) <= MAX_CHAIN else None
