"""The content of a grant as values: rights over names, and the restrictions on them.

Every value is checked when it is constructed, so a value that exists is well-formed: no unknown right,
operator or parameter can be represented. Whether a restriction fits a *message type* can only be checked with
its definition (`grants.guard`). A grant is valid while `not_before <= now < expires`, by the host's clock,
never ROS time.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import IntFlag
from typing import Any, Final, Self, TypeAlias

from ca.names import check_name, check_tail_pattern, covers_tree, pattern_covers, tail_base
from grants.errors import FilterRefused, GrantExpired, GrantMalformed, GrantNotYetValid
from grants.limits import MAX_PAD, MAX_SLOT, MIN_PAD, MIN_SLOT, is_body, rate_text

Scalar: TypeAlias = bool | int | float | str

KEY_SIZE: Final = 32  # a COSE key thumbprint, RFC 9679
ID_SIZE: Final = 16
MAX_NARROWINGS: Final = 3  # how many may follow a grant
MAX_CONDITION: Final = 1000  # characters
MAX_RATE: Final = 1_000_000
_MAX_TIME: Final = 1 << 53
KEEP_WHEN_STALE: Final = "kept while revocation data is stale"

_TYPE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_STEP: Final = r"[A-Za-z][A-Za-z0-9_]*(?:\[\*\])?"
_PATH: Final = re.compile(rf"{_STEP}(?:\.{_STEP})*", re.ASCII)


class Right(IntFlag):
    """Operations on a name: the permission bits of an AIF entry (RFC 9237)."""

    PUBLISH = 1
    SUBSCRIBE = 2
    CALL = 4
    PROVIDE = 8
    PARAM_GET = 16
    PARAM_SET = 32
    GRAPH = 64
    ADMIN = 128

    @property
    def label(self) -> str:
        return ", ".join(str(right.name).lower().replace("_", "-") for right in self)


ALL_RIGHTS: Final = Right(255)
MESSAGE_RIGHTS: Final = Right.PUBLISH | Right.SUBSCRIBE | Right.CALL | Right.PROVIDE
TREE_RIGHTS: Final = Right.PARAM_GET | Right.PARAM_SET


@dataclass(frozen=True, order=True)
class FilterRule:
    """One field (or subtree) of a message and the operator applied to it."""

    path: str  # field names joined by dots; `[*]` after an array of messages enters its elements
    operator: str  # a name in `grants.filters.operators`, for example `round`
    parameters: tuple[tuple[str, Scalar], ...] = ()  # by name, sorted

    def __post_init__(self) -> None:
        if _PATH.fullmatch(self.path) is None:
            raise FilterRefused(
                f"not a field path: {self.path[:80]!r}", "for example pose.position or status[*].name"
            )

    def __str__(self) -> str:
        parts = [self.operator, *(f"{name} {value}" for name, value in self.parameters)]
        return f"{self.path}: {' '.join(parts)}"


def filter_rules(rules: Mapping[Any, Any]) -> tuple[FilterRule, ...]:
    """Read `{path: {operator: parameter}}` from decoded data, sorted by path.

    The parameter is `True` for an operator without parameters, else a map of scalars:
    `{"header.frame_id": {"clear": True}, "pose.position": {"round": {"step": 0.5}}}`.
    """
    read = [_filter_rule(path, treatment) for path, treatment in rules.items()]
    return tuple(sorted(read, key=lambda rule: rule.path))


def _filter_rule(path: Any, treatment: Any) -> FilterRule:
    if not isinstance(path, str):
        raise FilterRefused(f"a field path is text, not {str(path)[:40]}", "for example header.seq")
    if not isinstance(treatment, Mapping) or len(treatment) != 1:
        raise FilterRefused(f"{path}: exactly one operator per field", "for example {clear: true}")
    [(operator, parameter)] = treatment.items()
    if not isinstance(operator, str):
        raise FilterRefused(
            f"{path}: an operator is text, not {str(operator)[:40]}", "for example {clear: true}"
        )
    if parameter is True:
        return FilterRule(path, operator)
    if not isinstance(parameter, Mapping) or len(parameter) == 0:
        raise FilterRefused(f"{path}: parameters of {operator} must be named", "{round: {step: 1}}")
    for name, value in parameter.items():
        if not isinstance(name, str) or not isinstance(value, Scalar):
            raise FilterRefused(f"{path}: parameter {name!r} is not a number, text or boolean")
    return FilterRule(path, operator, tuple(sorted(parameter.items())))


@dataclass(frozen=True)
class Restriction:
    """The conditions, filters and limits under which a right is granted."""

    # The right is granted for no other message type; None if no condition reads the message and nothing is
    # filtered.
    type: str | None = None
    conditions: tuple[str, ...] = ()  # texts in `grants.conditions.compile`; all of them must hold
    filters: tuple[FilterRule, ...] = ()
    rate: float | None = None  # at most so many messages a second, on average
    keep_when_stale: bool = False  # an open connection may stay while revocation data is stale
    # In a decision, how many links of a chain stand before its own: it is applied to what the restrictions
    # of these let through. 0 as signed.
    layer: int = 0
    slot: int | None = None  # one message in each slot of so many seconds, in its beginning (`grants.limits`)
    body: str | None = None  # shows the same as other topics of the publisher (`grants.filters.coarsening`)
    pad: int | None = None  # what is sent has, encrypted, a multiple of so many bytes

    def __post_init__(self) -> None:
        if self.type is not None and _TYPE.fullmatch(self.type) is None:
            raise GrantMalformed(f"not a message type: {self.type[:80]!r}")
        if not self.restricts_messages and not self.keep_when_stale:
            raise GrantMalformed("a restriction that restricts nothing")
        if self.filters and self.type is None:
            raise GrantMalformed("filters without a message type")
        if len({rule.path for rule in self.filters}) != len(self.filters):
            raise GrantMalformed("two filters for one field", "the order would matter: merge them")
        if any(not 0 < len(text) <= MAX_CONDITION for text in self.conditions):
            raise GrantMalformed(f"a condition is empty or longer than {MAX_CONDITION} characters")
        if self.rate is not None and not 0 < self.rate <= MAX_RATE:
            raise GrantMalformed(f"a rate must be above zero and at most {MAX_RATE} a second")
        if self.slot is not None and not MIN_SLOT <= self.slot <= MAX_SLOT:
            raise GrantMalformed(f"a slot must have {MIN_SLOT} to {MAX_SLOT} seconds")
        if self.body is not None and (self.slot is None or not is_body(self.body)):
            raise GrantMalformed(f"a body has a slot and a name, not {self.body[:40]!r}")
        if self.pad is not None and not MIN_PAD <= self.pad <= MAX_PAD:
            raise GrantMalformed(f"messages are padded to {MIN_PAD} to {MAX_PAD} bytes")

    @property
    def restricts_messages(self) -> bool:
        limited = (self.rate, self.slot, self.pad) != (None, None, None)
        return bool(self.conditions or self.filters) or limited

    def lines(self) -> list[str]:
        """The restriction as text, one line per condition, filter and limit."""
        lines = [f"only when {text}" for text in self.conditions]
        lines += [str(rule) for rule in self.filters]
        if self.rate is not None:
            lines.append(rate_text(self.rate))
        if self.slot is not None:
            lines.append(f"one message at the start of each {self.slot} s")
        if self.body is not None:
            lines.append(f"with all topics of the body {self.body}")
        if self.pad is not None:
            lines.append(f"padded to multiples of {self.pad} bytes")
        return [*lines, KEEP_WHEN_STALE] if self.keep_when_stale else lines


@dataclass(frozen=True)
class Permission:
    """Rights over the names a pattern covers, with the restriction *inside* (as in RFC 9237).

    A restriction in a sibling claim would be ignored by a verifier that does not know it. The
    pattern may be a tail pattern (`/rviz~/pose`), in a grant to the node of that tail only.
    """

    pattern: str
    rights: Right
    restriction: Restriction | None = None

    def __post_init__(self) -> None:
        check_tail_pattern(self.pattern)
        if not 0 < int(self.rights) <= int(ALL_RIGHTS):
            raise GrantMalformed(f"unknown or no right: {int(self.rights)}")
        what = f"{self.rights.label} on {self.pattern} cannot be"
        if self.restriction is not None and self.rights & ~MESSAGE_RIGHTS:
            hint = "put these rights into a separate permission"
            raise GrantMalformed(f"{what} restricted by message content", hint)
        padded = self.restriction is not None and self.restriction.pad is not None
        if padded and self.rights != Right.SUBSCRIBE:
            raise GrantMalformed(f"{what} padded", "only what is sent to a subscriber is")

    def __str__(self) -> str:
        return f"{self.rights.label} {self.pattern}"

    def lines(self) -> list[str]:
        """Its restriction as text: with `str`, how every command tells what a grant gives."""
        return [] if self.restriction is None else self.restriction.lines()

    @property
    def is_narrowed(self) -> bool:
        """Whether less than all messages, or less of them, are given."""
        return self.restriction is not None and self.restriction.restricts_messages

    def matches(self, name: str, right: Right) -> bool:
        """Whether the pattern covers `name`; for parameters also if it covers a parent of it."""
        return covers_tree(self.pattern, name) if right & TREE_RIGHTS else pattern_covers(self.pattern, name)

    def covers(self, right: Right, name: str) -> bool:
        return right in self.rights and self.matches(name, right)


@dataclass(frozen=True)
class Draft:
    """A grant before it is signed."""

    domain: str  # the trust domain in which it is valid (`home`)
    subject: str  # the node it is issued to, an absolute name; informational
    holder: bytes  # thumbprint of the node's public key, to which it is bound
    not_before: int  # seconds since the epoch, as `expires` and `cap`
    expires: int
    cap: int  # no renewal extends beyond it
    serial: bytes  # random
    permissions: tuple[Permission, ...]
    # How many narrowings may follow, each signed by the holder of the link before.
    may_narrow: int = field(default=0, kw_only=True)

    def __post_init__(self) -> None:
        check_name(self.subject)
        if not 0 < len(self.domain.encode()) <= 255:  # .size of a tstr counts bytes (RFC 8610)
            raise GrantMalformed("a grant needs a trust domain of 1 to 255 bytes")
        if len(self.holder) != KEY_SIZE or len(self.serial) != ID_SIZE:
            raise GrantMalformed("holder must be 32 bytes, serial 16")
        if not 0 <= self.not_before < self.expires <= self.cap < _MAX_TIME:
            raise GrantMalformed("a grant needs not_before < expires <= cap")
        if len(self.permissions) == 0:
            raise GrantMalformed("a grant that permits nothing")
        if not 0 <= self.may_narrow <= MAX_NARROWINGS:
            raise GrantMalformed(f"a grant allows at most {MAX_NARROWINGS} narrowings")
        bases = {tail_base(permission.pattern) for permission in self.permissions}
        if not bases <= {None, self.subject}:
            raise GrantMalformed(
                f"a grant to {self.subject} with a tail pattern of another node",
                f"its own is {self.subject}~/...",
            )
        if self.may_narrow and bases != {None}:
            raise GrantMalformed(
                "a grant with a tail pattern that may be narrowed",
                "the names of anonymous nodes are handed on to nobody",
            )

    @property
    def has_tail_patterns(self) -> bool:
        """Whether it gives rights on the names of anonymous nodes, which only its subject has."""
        return any(tail_base(permission.pattern) for permission in self.permissions)

    def covers(self, right: Right, name: str) -> bool:
        return any(permission.covers(right, name) for permission in self.permissions)


@dataclass(frozen=True)
class Grant(Draft):
    """A grant as signed: `id` identifies it for revocation, `issuer` is the authority's thumbprint.

    `via` is set by renewal: the delegation's id and its holder's key. Both may be revoked.
    A chain (`grants.token`) is one grant too: the first link's, with the id, subject and holder
    of the last, valid while every link is; `chain` is all of them, and each must authorize.
    """

    id: bytes
    issuer: bytes
    via: tuple[bytes, ...] = ()
    chain: tuple["Grant", ...] = ()

    @classmethod
    def of(cls, draft: Draft, *, id: bytes, issuer: bytes) -> Self:  # noqa: A002 - the field has that name
        return cls(**vars(draft), id=id, issuer=issuer)

    @property
    def links(self) -> tuple["Grant", ...]:
        return self.chain or (self,)

    @property
    def revocable(self) -> tuple[bytes, ...]:
        """Every id and key that ends it when revoked; the key of a single grant is its peer's."""
        if not self.chain:
            return (self.id, *self.via)
        ids = (entry for link in reversed(self.chain) for entry in (link.id, *link.via))
        return (*ids, *(link.holder for link in self.chain))

    def covers(self, right: Right, name: str) -> bool:
        """Whether every link gives `right` on `name` (restricted or not)."""
        return all(any(each.covers(right, name) for each in link.permissions) for link in self.links)

    @property
    def short_id(self) -> str:
        return self.id.hex()[:8]


def merge(restrictions: Iterable[Restriction | None]) -> tuple[Restriction, ...]:
    """All restrictions that apply together, each once, layer by layer, in an order of their own.

    Restrictions of messages only: `keep_when_stale` is less strict, and the caller combines it.
    """
    unique = {
        replace(restriction, keep_when_stale=False)
        for restriction in restrictions
        if restriction is not None and restriction.restricts_messages
    }
    return tuple(sorted(unique, key=lambda each: (each.layer, repr(each))))


def check_time(grant: Grant, now: int) -> None:
    """Return if `grant` is valid at `now` (seconds since the epoch)."""
    if now < grant.not_before:
        raise GrantNotYetValid(
            f"grant {grant.short_id} is not valid before {format_time(grant.not_before)}",
            "check this host's clock",
        )
    if now >= grant.expires:
        raise GrantExpired(
            f"grant {grant.short_id} expired at {format_time(grant.expires)}",
            "ask the authority to renew it, or check this host's clock",
        )


def format_time(seconds: int) -> str:
    """Seconds since the epoch as `2026-11-20 18:00:00 UTC`; the number if out of range."""
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return f"second {seconds}"
