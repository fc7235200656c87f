"""The request for a grant, signed by the node's own key; the words for rights that no rule gives. Pure.

The format is that of a grant (closed COSE_Sign1, AIF scope), so the same attacks are prevented; the reason is
the node's text, and shown as such. A node is told nothing but what it asked for itself; which rules nearly
match only the authority knows (`rossec explain`).
"""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, NameRefused, SignatureError
from ca.keys.signing import Profile, Signer
from ca.names import check_name, check_tail_pattern, covers, tail_base
from grants.errors import GrantForged, GrantMalformed
from grants.model import ALL_RIGHTS, Right

# What the client library of every ROS program asks for by itself: rospy and roscpp publish their log, offer
# two services to change its levels, follow `/clock` where time is simulated, and read the settings. A
# program works without them; `basics` of a policy (`grants.policy.rules`) gives them. Names of the node's
# own are after `{node}/`. Sources: rospy `client.py`, `impl/{simtime,statistics,tcpros_base,rosout}.py`;
# roscpp `init.cpp`, `rosout_appender.cpp`, `statistics.cpp`, `topic_manager.cpp`.
OWN: Final = "{node}/"
TRANSFORMS: Final = ("/tf", "/tf_static")
BASICS: Final[Mapping[Right, tuple[str, ...]]] = {
    Right.PUBLISH: ("/rosout",),
    Right.PROVIDE: (f"{OWN}get_loggers", f"{OWN}set_logger_level"),
    Right.SUBSCRIBE: ("/clock",),
    Right.PARAM_GET: (
        *("/use_sim_time", "/tcp_keepalive", "/rosout_disable_topics_generation", "/enable_statistics"),
        *(f"/statistics_window_{end}_{what}" for what in ("elements", "size") for end in ("min", "max")),
    ),
}

_RIGHTS: Final = {right.label: right for right in ALL_RIGHTS}

# rospy ends the name of an anonymous node with its start in ms, roscpp in ns.
_TIMED: Final = re.compile(r"(?:_[A-Za-z0-9]+)*_[0-9]{9,}", re.ASCII)
_RUN: Final = re.compile(r"(?:_[0-9]+)*_[0-9]{9,}(?=/|$)", re.ASCII)


def own_form(node: str, name: str, *, wildcard: bool = False) -> str:
    """`name`, written with `{node}/` where it lies below the node's own name.

    `wildcard`: `node` is certified with a tail, and has the names of all its anonymous nodes.
    """
    parts = name.split("/")
    depth = node.count("/") + 1
    asker = "/".join(parts[:depth])
    if len(parts) > depth and (covers(node, asker, wildcard=wildcard) or is_timed(node, asker)):
        return OWN + "/".join(parts[depth:])
    return name


def is_timed(node: str, name: str) -> bool:
    """Whether `name` is that of one run of an anonymous node of `node`: it will not come again."""
    return name.startswith(node) and _TIMED.fullmatch(name, len(node)) is not None


def lasting_name(name: str) -> str:
    """The name of an anonymous node without the numbers of one run; any other as it is."""
    return _RUN.sub("", name)


def is_basic(right: Right, own: str) -> bool:
    """Whether a client library asks for `right` on `own`, in the form of `own_form`, by itself."""
    return own in BASICS.get(right, ())


def is_dispensable(right: Right, own: str) -> bool:
    """Whether it is such a right, and a program works without it: without `/clock` time stands."""
    return right is not Right.SUBSCRIBE and is_basic(right, own)


_STATUS: Final = re.compile(
    r"(?:rossec: )?(\S+?)(?: \(certified as (\S+)\))? needs the right ([a-z-]+) on (\S+):"
    r" no grant .*",
    re.DOTALL,
)
_IN_SHELL: Final = re.compile(r"[A-Za-z0-9_/:]+", re.ASCII)
_PLAIN: Final = re.compile(r"[^{}\[\],:#&*!|>'\"%@`\s][^{}\[\],:#\s]*", re.ASCII)


class MissingRight(NamedTuple):
    """A right that `node`, a certified name, lacks; `asker` is its name where it is anonymous."""

    node: str
    asker: str
    right: Right
    name: str

    @property
    def own(self) -> str:
        return own_form(self.node, self.name, wildcard=self.asker != self.node)

    @property
    def in_rule(self) -> str:
        """The name as a rule would write it."""
        return rule_form(self.node, self.name, wildcard=self.asker != self.node)

    def __str__(self) -> str:
        return f"{self.node} may not {self.right.label} {self.name}"


def rule_form(node: str, name: str, *, wildcard: bool) -> str:
    """`name` as a rule would write it: with `{node}` where it is of one run of `node` only."""
    return name if name.startswith(f"{node}/") else own_form(node, name, wildcard=wildcard)


def missing_right(status: str) -> MissingRight | None:
    """What the status of a refused call says is missing; None if it was refused otherwise."""
    match = _STATUS.fullmatch(status)
    if match is None or match[3] not in _RIGHTS:
        return None
    return MissingRight(match[2] or match[1], match[1], _RIGHTS[match[3]], match[4])


def needed_rule(node: str, rights: Iterable[tuple[Right, str]]) -> str:
    """What would give `node` these rights: `an allow rule for /x with subscribe: [/y]`."""
    names: dict[str, list[str]] = {}
    for right, name in dict.fromkeys(rights):
        names.setdefault(right.label, []).append(name if _PLAIN.fullmatch(name) else f"'{name}'")
    given = ", ".join(f"{label}: [{', '.join(found)}]" for label, found in names.items())
    return f"an allow rule for {node} with {given}"


def grant_command(node: str, rights: Iterable[tuple[Right, str]]) -> str:
    """The command that gives `node` these rights, for who holds the authority."""
    options = dict.fromkeys(
        "--graph" if right is Right.GRAPH else f"--{right.label} {in_shell(name)}" for right, name in rights
    )
    return f"rossec grant sign {node} {' '.join(options)}"


def remedy(node: str, right: Right, name: str) -> str:
    """The commands that give `node` a right it lacks, on a name as `MissingRight.in_rule` has it.

    Short: an answer to many calls in one says it for each of them.
    """
    sign = grant_command(node, [(right, name)])
    return sign if right is Right.ADMIN else f"{sign}, or ask: `rossec grant request`"


def in_shell(name: str) -> str:
    """A name or pattern as it is typed in a shell."""
    return name if _IN_SHELL.fullmatch(name) else f"'{name}'"


def refusal(node: str, missing: Iterable[tuple[Right, str]]) -> str:
    """One line for all that `node` lacks, at least one right: with a policy, and without one."""
    [first, *more] = listed = list(dict.fromkeys(missing))
    what = "do all that it asks for" if more else f"{first[0].label} {first[1]}"
    command = grant_command(node, listed)
    return f"{node} may not {what}: {needed_rule(node, listed)} would change it, or {command}"


REQUEST: Final = Profile("rossec-request+cwt")
MAX_RIGHTS: Final = 64
MAX_REASON: Final = 500
MAX_CLOCK_SKEW: Final = 300  # seconds a request may be dated in the future
# Request files may be carried by hand. It gives no right: one that is replayed only asks again for the same
# node, and the record accepts each once.
MAX_AGE: Final = 7 * 86400

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
        return hashlib.sha256(_ID_DOMAIN + encode(_claims(self))).digest()[:16]


def sign_request(signer: Signer, request: GrantRequest) -> bytes:
    """Sign `request` with the node's key."""
    return REQUEST.sign(signer, _claims(request))


def peek_request(data: bytes) -> GrantRequest:
    """Return its content *without* verifying it: to find the key of the node it names."""
    try:
        return _read(REQUEST.peek(data))
    except (SignatureError, EncodingError, NameRefused) as error:
        raise GrantMalformed(f"not a request for a grant: {error}") from None


def open_request(data: bytes, key: ec.EllipticCurvePublicKey, *, domain: str, now: int) -> GrantRequest:
    """Verify a request with the key of the node it names."""
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
            rights: list[RequestedRight] = []
            for entry in _typed(decode(_typed(claims[_SCOPE], bytes)), list):
                match entry:
                    case [str() as pattern, int() as bits] if 0 < bits <= int(ALL_RIGHTS):
                        rights.append(RequestedRight(Right(bits), pattern))
                    case _:
                        raise GrantMalformed("a requested right is not [pattern, right]")
            return GrantRequest(
                domain=_typed(claims[_AUD], str),
                node=_typed(claims[_SUB], str),
                issued=_typed(claims[_IAT], int),
                serial=_typed(claims[_CTI], bytes),
                rights=tuple(rights),
                why=_typed(claims[_WHY], str),
            )
        case _:
            raise GrantMalformed("not the claims of a request")


def _typed(value: Any, kind: type[Any]) -> Any:
    if type(value) is not kind:
        raise GrantMalformed("a claim of the request is of a wrong type")
    return value
