"""The request for a grant, signed by the node with its own key. Pure.

The format is that of a grant (closed COSE_Sign1, AIF scope), so the same attacks are prevented; the
reason is the node's text, and shown as such. A request gives no right: a replayed request only asks
again for the same node, and the record accepts a request once only.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, NameRefused, SignatureError
from ca.keys.signer import Signer
from ca.names import check_name
from ca.patterns import check_tail_pattern, tail_base
from grants.errors import GrantForged, GrantMalformed
from grants.model import ALL_RIGHTS, Right

REQUEST: Final = Profile("rossec-request+cwt")
MAX_RIGHTS: Final = 64
MAX_REASON: Final = 500
MAX_CLOCK_SKEW: Final = 300  # seconds a request may be dated in the future
MAX_AGE: Final = 7 * 86400  # request files may be carried by hand

_SUB, _AUD, _IAT, _CTI, _SCOPE, _WHY = 2, 3, 6, 7, 9, -65538
_CLAIMS: Final = {_SUB, _AUD, _IAT, _CTI, _SCOPE, _WHY}
_ID_DOMAIN: Final = b"rossec-request-id\0"


@dataclass(frozen=True, order=True)
class RequestedRight:
    """One right a node requests, on a name or pattern."""

    right: Right
    pattern: str

    def __str__(self) -> str:
        return f"{self.right.label} {self.pattern}"


@dataclass(frozen=True)
class GrantRequest:
    """A request of `node` to the authority of `domain` at `issued` (seconds since the epoch)."""

    domain: str
    node: str
    issued: int
    serial: bytes
    rights: tuple[RequestedRight, ...]
    why: str

    def __post_init__(self) -> None:
        check_name(self.node)
        if not 0 < len(self.rights) <= MAX_RIGHTS:
            raise GrantMalformed(f"a request names 1 to {MAX_RIGHTS} rights")
        for requested in self.rights:
            check_tail_pattern(requested.pattern)
            if tail_base(requested.pattern) not in (None, self.node):
                raise GrantMalformed(f"{self.node} asks for names of another's anonymous nodes")
            if requested.right not in list(ALL_RIGHTS):
                raise GrantMalformed(f"{int(requested.right)} is not one right")
        if len(self.why) > MAX_REASON:
            raise GrantMalformed(f"a reason has at most {MAX_REASON} characters")
        if len(self.serial) != 16 or not 0 <= self.issued < 1 << 53:
            raise GrantMalformed("serial must be 16 bytes, issued a time")

    @property
    def id(self) -> bytes:
        """The 16 bytes that identify it."""
        return hashlib.sha256(_ID_DOMAIN + encode(_claims(self))).digest()[:16]


def sign_request(signer: Signer, request: GrantRequest) -> bytes:
    """Sign `request` with the node's key."""
    return REQUEST.sign(signer, _claims(request))


def peek_request(data: bytes) -> GrantRequest:
    """Return its content *without* verifying it: to find the key of the node it names.

    Raises:
        GrantMalformed: not a request.
    """
    try:
        return _read(REQUEST.peek(data))
    except (SignatureError, EncodingError, NameRefused) as error:
        raise GrantMalformed(f"not a request for a grant: {error}") from None


def open_request(
    data: bytes, key: ec.EllipticCurvePublicKey, *, domain: str, now: int
) -> GrantRequest:
    """Verify a request with the key of the node it names.

    Raises:
        GrantMalformed: not a request.
        GrantForged: not signed by `key`, for another authority, too old or dated in the future.
    """
    request = peek_request(data)
    try:
        REQUEST.open(data, key)
    except SignatureError as error:
        raise GrantForged(f"not a request of {request.node}: {error}") from None
    if request.domain != domain:
        raise GrantForged(f"a request to the authority of {request.domain!r}, not {domain!r}")
    if not now - MAX_AGE <= request.issued <= now + MAX_CLOCK_SKEW:
        raise GrantForged(
            f"the request of {request.node} is too old, or dated in the future",
            "repeat `rossec grant request`, and compare the clocks",
        )
    return request


def _claims(request: GrantRequest) -> Value:
    scope: list[Value] = [[requested.pattern, int(requested.right)] for requested in request.rights]
    return {
        _SUB: request.node,
        _AUD: request.domain,
        _IAT: request.issued,
        _CTI: request.serial,
        _SCOPE: encode(scope),
        _WHY: request.why,
    }


def _read(payload: Value) -> GrantRequest:
    match payload:
        case {**claims} if claims.keys() == _CLAIMS:
            return GrantRequest(
                domain=_typed(claims[_AUD], str),
                node=_typed(claims[_SUB], str),
                issued=_typed(claims[_IAT], int),
                serial=_typed(claims[_CTI], bytes),
                rights=tuple(
                    _requested_rights(_typed(decode(_typed(claims[_SCOPE], bytes)), list))
                ),
                why=_typed(claims[_WHY], str),
            )
        case _:
            pass
    raise GrantMalformed("not the claims of a request")


def _requested_rights(entries: list[Value]) -> Iterable[RequestedRight]:
    for entry in entries:
        match entry:
            case [str() as pattern, int() as bits] if 0 < bits <= int(ALL_RIGHTS):
                yield RequestedRight(Right(bits), pattern)
            case _:
                raise GrantMalformed("a requested right is not [pattern, right]")


def _typed(value: Any, kind: type[Any]) -> Any:
    if type(value) is not kind:
        raise GrantMalformed("a claim of the request is of a wrong type")
    return value
