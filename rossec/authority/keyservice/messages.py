"""Messages to the authority's service, and between it and its network process: bytes and values. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR
(`ca.encoding`); the length is checked before anything is read. A request is `[1, operation,
argument...]`: 1 is the version, `OPERATIONS` says which arguments an operation has. An answer is
`[0, value]`, or `[1, kind, message, hint]` for a refusal, whose kind is in `REFUSALS`.

Between the two processes `[0, number, operation, argument...]` is a request, `[1, number, value]`
its answer, `[2, number, message, hint]` a refusal; each side numbers its own requests. What
strangers send reaches the service as the octets of one `join` or `name`, of a fixed layout and
bounded.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple, TypeAlias

from cryptography import x509

from ca import errors
from ca.authority import read_unsigned
from ca.domains import DOMAINS, TRUST_BUNDLE
from ca.encoding import Value, decode, encode
from ca.enrollment.invitation import MAX_CLAIM_SIZE as MAX_CLAIM
from ca.enrollment.invitation import MAX_REQUEST_SIZE as MAX_JOIN
from ca.keys.signing import Profile
from ca.revocation.lists import LIST_PROFILE, MAX_LIST, MAX_TREE_ENTRIES_SIZE, TREE
from ca.store.values import HEAD_PROFILE
from ca.things import THING
from grants import document, renewal
from rossec.errors import (
    AuthorityLocked,
    KeyMessageRefused,
    KeyServiceRefused,
    PhoneCodeRefused,
    SigningRefused,
)

MAX_MESSAGE: Final = MAX_LIST + 512  # the largest statement is a revocation list
# All that the authority's key signs, besides certificates: the service signs for every program of its user,
# and must not become an oracle. What nodes or the master sign is not here.
_STATEMENTS: Final[Mapping[str, Profile]] = {
    "a grant": document.GRANT,
    "a delegation": renewal.DELEGATION,
    "a revocation list": LIST_PROFILE,
    "a revocation tree": TREE,
    "a head of the log": HEAD_PROFILE,
    "a list of domains": DOMAINS,
    "a bundle of its domain": TRUST_BUNDLE,
    "a statement about a thing": THING,
}
_HINT: Final = "the program that asked is of another version of rossec, or not rossec"


class ServedAuthority(NamedTuple):
    subject: x509.Name
    domain: str


def kind_of(message: bytes, authority: ServedAuthority) -> str:
    if len(message) > MAX_MESSAGE:
        raise SigningRefused(f"{len(message)} bytes to sign are more than any statement", _HINT)
    for kind, profile in _STATEMENTS.items():
        try:
            profile.payload_to_sign(message, limit=MAX_MESSAGE)
        except (errors.SignatureError, errors.EncodingError):
            continue
        return kind
    try:
        found = read_unsigned(message, authority.subject, authority.domain)
    except errors.CertificateRefused as error:
        raise SigningRefused("these bytes are nothing that an authority signs", _HINT) from error
    return f"a certificate of {'the intermediate of ' * found.is_intermediate}{found.name}"


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
REFUSALS: Final[Mapping[str, type[errors.HintedError]]] = {
    "locked": AuthorityLocked,
    "unknown": SigningRefused,
    "passphrase": errors.PassphraseRefused,
    "token": errors.TokenRefused,
    "code": PhoneCodeRefused,
    "refused": KeyServiceRefused,
    "malformed": KeyMessageRefused,
}
_MESSAGES_HINT: Final = "are the service and the command of one version of rossec?"


class ServiceRequest(NamedTuple):
    operation: str
    arguments: tuple[Value, ...] = ()


def frame(value: Value) -> bytes:
    body = encode(value)
    return len(body).to_bytes(HEAD) + body


def frame_size(head: bytes, limit: int = MAX_FRAME) -> int:
    # Before the body is read, so that a peer cannot make this side wait for, or keep, more than the limit.
    size = int.from_bytes(head)
    if not 0 < size <= limit:
        raise KeyMessageRefused(f"a message of {size} bytes where 1 to {limit} are allowed", _MESSAGES_HINT)
    return size


def write_request(request: ServiceRequest) -> bytes:
    return frame([VERSION, request.operation, *request.arguments])


def read_request(
    body: bytes, operations: Mapping[str, tuple[type, ...]] = OPERATIONS, limit: int = MAX_FRAME
) -> ServiceRequest:
    match _decode(body, limit):
        case [version, str() as operation, *arguments] if operation in operations:
            is_version = type(version) is int and version == VERSION  # True would be equal to 1
            if is_version and tuple(map(type, arguments)) == operations[operation]:
                return ServiceRequest(operation, tuple(arguments))
    raise KeyMessageRefused("a request that is not in the table of operations", _MESSAGES_HINT)


def write_answer(value: Value) -> bytes:
    return frame([0, value])


def write_refusal(error: errors.HintedError) -> bytes:
    kinds = {refusal: kind for kind, refusal in REFUSALS.items()}
    return frame([1, kinds.get(type(error), "refused"), str(error), error.hint])


def read_answer(body: bytes, limit: int = MAX_FRAME) -> Value:
    match _decode(body, limit):
        case [0, value]:
            return value
        case [1, str() as kind, str() as message, str() as hint] if kind in REFUSALS:
            raise REFUSALS[kind](message, hint)
    raise KeyMessageRefused("an answer of another form", _MESSAGES_HINT)


def _decode(body: bytes, limit: int) -> Value:
    try:
        return decode(body, limit=limit)
    except errors.EncodingError as error:
        raise KeyMessageRefused(f"a message that is malformed: {error}", _MESSAGES_HINT) from error


MAX_FROM_FACE: Final = 1024 * 1024  # the master answers so much at most
MAX_FROM_SERVICE: Final = MAX_TREE_ENTRIES_SIZE + 64 * 1024
MAX_NUMBER: Final = 1 << 32

READY, FAILED, JOIN, NAME, CALL = "ready", "failed", "join", "name", "call"
INNER_OPERATIONS: Final[Mapping[str, tuple[type, ...]]] = {
    READY: (int,),  # from the face: it listens on this port; 0: on none
    FAILED: (str, str),  # from the face: it cannot; message and hint
    JOIN: (bytes,),  # from the face: a node's request; answered with a message for the node
    NAME: (bytes,),  # from the face: a node's claim; answered with a message for the node
    CALL: (str, list, int),  # from the service: method, arguments, seconds; the master's answer
}


class InnerRequest(NamedTuple):
    number: int
    operation: str
    arguments: tuple[Value, ...]


class InnerAnswer(NamedTuple):
    number: int
    value: Value


class InnerRefusal(NamedTuple):
    number: int
    message: str
    hint: str


InnerMessage: TypeAlias = InnerRequest | InnerAnswer | InnerRefusal


def write(message: InnerMessage) -> bytes:
    match message:
        case InnerRequest(number, operation, arguments):
            return frame([0, number, operation, *arguments])
        case InnerAnswer(number, value):
            return frame([1, number, value])
        case _:
            return frame([2, *message])


def read(body: bytes, limit: int) -> InnerMessage:
    match _decode(body, limit):
        # The types are compared exactly: True is equal to 1, and is an int.
        case [int() as kind, int() as number, *rest] if (
            type(kind) is int and type(number) is int and 0 <= number < MAX_NUMBER
        ):
            match kind, rest:
                case 0, [str() as operation, *arguments] if _is_allowed(operation, arguments):
                    return InnerRequest(number, operation, tuple(arguments))
                case 1, [value]:
                    return InnerAnswer(number, value)
                case 2, [str() as message, str() as hint]:
                    return InnerRefusal(number, message, hint)
                case _:
                    pass
    raise KeyMessageRefused("a message that is not in the table of operations")


def _is_allowed(operation: str, arguments: list[Value]) -> bool:
    if tuple(map(type, arguments)) != INNER_OPERATIONS.get(operation):
        return False
    match operation, arguments:
        case "join", [bytes() as request]:
            return len(request) <= MAX_JOIN
        case "name", [bytes() as claim]:
            return len(claim) <= MAX_CLAIM
        case "ready", [int() as port]:
            return 0 <= port < 1 << 16
        case _:
            return True
