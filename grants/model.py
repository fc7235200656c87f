"""The content of a grant as values: rights over names, and the restrictions on them.

Every value is checked when it is constructed, so a value that exists is well-formed: no unknown
right, operator or parameter can be represented. Whether a restriction fits a *message type* can
only be checked with its definition (`grants.guard`).
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import Any, Final, Self, TypeAlias

from ca.names import check_name
from ca.patterns import check_tail_pattern, covers, covers_tree, tail_base
from grants.errors import FilterRefused, GrantMalformed
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
        """The right as text: `publish`, `param-get`, `publish, subscribe`."""
        return ", ".join(str(right.name).lower().replace("_", "-") for right in self)


ALL_RIGHTS: Final = Right(255)
MESSAGE_RIGHTS: Final = Right.PUBLISH | Right.SUBSCRIBE | Right.CALL | Right.PROVIDE
TREE_RIGHTS: Final = Right.PARAM_GET | Right.PARAM_SET


@dataclass(frozen=True, order=True)
class FilterRule:
    """One field (or subtree) of a message and the operator applied to it.

    Args:
        path: field names joined by dots; `[*]` after an array of messages enters its elements.
        operator: a name in `grants.filters.operators`, for example `round`.
        parameters: the operator's parameters by name, sorted.
    """

    path: str
    operator: str
    parameters: tuple[tuple[str, Scalar], ...] = ()

    def __post_init__(self) -> None:
        if _PATH.fullmatch(self.path) is None:
            raise FilterRefused(
                f"not a field path: {self.path[:80]!r}",
                "for example pose.position or status[*].name",
            )

    def __str__(self) -> str:
        parts = [self.operator, *(f"{name} {value}" for name, value in self.parameters)]
        return f"{self.path}: {' '.join(parts)}"


def filter_rules(rules: Mapping[Any, Any]) -> tuple[FilterRule, ...]:
    """Read `{path: {operator: parameter}}` from decoded data, sorted by path.

    The parameter is `True` for an operator without parameters, else a map of scalars:
    `{"header.frame_id": {"clear": True}, "pose.position": {"round": {"step": 0.5}}}`.

    Raises:
        FilterRefused: anything else.
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
    return FilterRule(path, operator, _parameters(path, parameter))


def _parameters(path: str, named: Mapping[object, object]) -> tuple[tuple[str, Scalar], ...]:
    pairs: list[tuple[str, Scalar]] = []
    for name, value in named.items():
        if not isinstance(name, str) or not isinstance(value, Scalar):
            raise FilterRefused(f"{path}: parameter {name!r} is not a number, text or boolean")
        pairs.append((name, value))
    return tuple(sorted(pairs))


@dataclass(frozen=True)
class Restriction:
    """The conditions, filters and rate under which a right is granted.

    Args:
        type: the message type it is for; None if no condition reads the message and nothing is
            filtered. The right is not granted for any other type.
        conditions: texts in `grants.conditions.compile`; all of them must hold.
        filters: the operators applied to the fields of each message.
        rate: at most so many messages a second, on average.
        slot: one message in each slot of so many seconds, in its beginning (`grants.limits`).
        keep_when_stale: an established connection may stay open while revocation data is stale.
        layer: in a decision, how many links of a chain stand before its own: it is applied to what
            the restrictions of these let through. 0 as signed.
        body: what shows the same thing as other topics of the publisher (`grants.common_state`).
        pad: what is sent for the right has, encrypted, a multiple of so many bytes.
    """

    type: str | None = None
    conditions: tuple[str, ...] = ()
    filters: tuple[FilterRule, ...] = ()
    rate: float | None = None
    keep_when_stale: bool = False
    layer: int = 0
    slot: int | None = None
    body: str | None = None
    pad: int | None = None

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
        """Whether it applies to messages; a caller without messages has nothing to apply."""
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
        if self.restriction is not None and self.rights & ~MESSAGE_RIGHTS:
            raise GrantMalformed(
                f"{self.rights.label} on {self.pattern} cannot be restricted by message content",
                "put these rights into a separate permission",
            )
        padded = self.restriction is not None and self.restriction.pad is not None
        if padded and self.rights != Right.SUBSCRIBE:
            raise GrantMalformed(
                f"{self.rights.label} on {self.pattern} cannot be padded",
                "only what is sent to a subscriber is",
            )

    def matches(self, name: str, right: Right) -> bool:
        """Whether the pattern covers `name`; for parameters also if it covers a parent of it."""
        return (
            covers_tree(self.pattern, name) if right & TREE_RIGHTS else covers(self.pattern, name)
        )

    def covers(self, right: Right, name: str) -> bool:
        """Whether this permission gives `right` on `name` (restricted or not)."""
        return right in self.rights and self.matches(name, right)


@dataclass(frozen=True)
class Draft:
    """A grant before it is signed.

    Args:
        domain: the trust domain in which it is valid (`home`).
        subject: the node it is issued to, an absolute name; informational.
        holder: thumbprint of the node's public key, 32 bytes; the grant is bound to it.
        not_before, expires, cap: seconds since the epoch; it is valid while
            `not_before <= now < expires`; no renewal extends beyond `cap`.
        serial: 16 random bytes.
        permissions: at least one.
        may_narrow: how many narrowings may follow, each signed by the holder of the link before.
    """

    domain: str
    subject: str
    holder: bytes
    not_before: int
    expires: int
    cap: int
    serial: bytes
    permissions: tuple[Permission, ...]
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
        """Whether one of its permissions gives `right` on `name` (restricted or not)."""
        return any(permission.covers(right, name) for permission in self.permissions)


@dataclass(frozen=True)
class Grant(Draft):
    """A grant as signed: `id` identifies it for revocation, `issuer` is the authority's thumbprint.

    `via` is set by renewal: the delegation's id and its holder's key. Both may be revoked.
    A chain (`grants.narrowing`) is one grant too: the first link's, with the id, subject and holder
    of the last, valid while every link is; `chain` is all of them, and each must authorize.
    """

    id: bytes
    issuer: bytes
    via: tuple[bytes, ...] = ()
    chain: tuple["Grant", ...] = ()

    @classmethod
    def of(cls, draft: Draft, *, id: bytes, issuer: bytes) -> Self:  # noqa: A002 - the field has that name
        """The signed form of `draft`."""
        return cls(**vars(draft), id=id, issuer=issuer)

    @property
    def links(self) -> tuple["Grant", ...]:
        """The grant as signed, then its narrowings in order; `(self,)` if there are none."""
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
        return all(
            any(permission.covers(right, name) for permission in link.permissions)
            for link in self.links
        )

    @property
    def short_id(self) -> str:
        """The first 8 hexadecimal digits of the id."""
        return self.id.hex()[:8]


def merge(restrictions: Iterable[Restriction | None]) -> tuple[Restriction, ...]:
    """All restrictions that apply together, each once, layer by layer; the order of one layer does
    not depend on the input's.

    Restrictions of messages only: `keep_when_stale` is less strict, and the caller combines it.
    """
    unique = {
        replace(restriction, keep_when_stale=False)
        for restriction in restrictions
        if restriction is not None and restriction.restricts_messages
    }
    return tuple(sorted(unique, key=lambda each: (each.layer, repr(each))))
