"""A caller of the master and its rights at one time. Pure, default deny.

A right on an alias (`/remote/LABEL/...`) is the right on the origin's name, from grants of the
origin's domain: a grant of the own one, whatever its pattern, gives no more there than `graph` and
`admin`, which concern the own master. Nothing below `/remote` is published, provided or set here. A
foreign caller has its alias as name, calls itself by its name at home, and sees no aliases: what
was imported is shown to no other domain.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, Protocol

from ca import names
from ca.domains.aliases import REMOTE, is_alias, origin_of, shown, split_alias
from ca.domains.served import served_name
from ca.errors import HintedError, NameRefused, NotAdmitted
from grants.errors import GrantMissing
from grants.missing_rights import remedy, rule_form
from grants.model import ALL_RIGHTS, Right
from grants.reach import Reach
from rossec.master.state.registry import NodeRef

NAMES_PER_YIELD: Final = 64
VISIBILITY_RIGHTS: Final = (
    Right.PUBLISH | Right.SUBSCRIBE | Right.CALL | Right.PROVIDE | Right.GRAPH
)
OWN_DOMAIN: Final = ""  # what a site of the own domain has as domain of its label
_AT_HOME: Final = Right.GRAPH | Right.ADMIN  # what own grants give on aliases
_AT_ORIGIN: Final = Right.SUBSCRIBE | Right.CALL | Right.PARAM_GET | Right.GRAPH
_NOT_EXPORTED: Final = Right.GRAPH | Right.ADMIN  # on the master itself; what is shown is bounded


class Refused(Exception):
    """The status text to answer with, after `rossec: `.

    `missing` is the right that is missing, and the name it is missing on, if that was the reason.
    """

    def __init__(self, text: str, missing: tuple[Right, str] | None = None) -> None:
        super().__init__(text)
        self.missing = missing


class AddressTaken(Refused):
    """The address is registered by `owner`, which may be gone: only a probe can tell."""

    def __init__(self, owner: NodeRef) -> None:
        super().__init__("this address is registered by another node")
        self.owner = owner


class Peer(Protocol):
    """A certified name and its key: a `ca.certificates.Identity` or a `NodeRef`."""

    @property
    def name(self) -> str:
        """The certified name; of a foreigner its alias."""

    @property
    def thumbprint(self) -> bytes:
        """The certified key's thumbprint."""


_SAID: Final = 2  # near misses beside the command that gives the right
Authorize = Callable[[Right, str], object]
"""Raises the `HintedError` that says why no valid grant covers a right on a name."""

DomainOf = Callable[[str], str | None]
"""The trust domain of a label; `OWN_DOMAIN` for a site of the own one; None: no such label."""


class OriginRights(NamedTuple):
    """What a caller's grants of one foreign domain give, on names of that domain."""

    reach: Reach
    authorize: Authorize


def no_domain(_: str) -> str | None:
    """Neither foreign domains nor other sites are known."""
    return None


@dataclass(frozen=True)
class Caller:
    """A caller and its rights at one time, from the grants it presented.

    Attributes:
        name: the certified name, of a foreigner its alias; within a call the name of the node, see
            `acting_as`.
        thumbprint: of the certified key, to which grants are bound.
        reach: what its valid grants of the own domain cover.
        authorize: called for a right on a name that `reach` does not cover.
        wildcard: the certified name has a wildcard tail.
        certified: the certified name where `name` is another one.
        is_authority: it is the authority's own node, see `access_rules.is_authority`.
        is_own_master: it is a listed master of the own domain.
        elsewhere: what its grants of foreign domains give, by trust domain.
        domain_of: resolves the labels of aliases.
        exported: what a foreigner's domain is shown and given at all; None: what grants allow.
    """

    name: str
    thumbprint: bytes
    reach: Reach
    authorize: Authorize
    wildcard: bool = False
    certified: str = ""
    is_authority: bool = False
    is_own_master: bool = False
    elsewhere: Mapping[str, OriginRights] = field(default_factory=dict, hash=False)
    domain_of: DomainOf = no_domain
    exported: Reach | None = None

    @property
    def display_name(self) -> str:
        """The names, for people."""
        name = shown(self.name)
        return f"{name} (certified as {self.certified})" if self.certified else name

    @property
    def identity(self) -> str:
        """The certified name, for people."""
        return shown(self.certified or self.name)

    @property
    def has_tail(self) -> bool:
        """Whether its certified name has a wildcard tail, by which `acting_as` took another."""
        return self.wildcard or bool(self.certified)

    @property
    def is_foreign(self) -> bool:
        """Whether it is a node of a foreign domain."""
        return is_alias(self.name)

    @property
    def has_rights(self) -> bool:
        """Whether anything but its certificate speaks for it: grants, or what it is."""
        if self.is_authority or self.is_own_master or not self.reach.is_empty:
            return True
        return any(not each.reach.is_empty for each in self.elsewhere.values())

    def acting_as(self, name: str) -> "Caller":
        """The caller as the node `name`, which has its own entries in the registry.

        Raises:
            Refused: its identity does not cover `name`.
        """
        if name == self.name and not name.startswith(REMOTE):  # the usual case
            return self
        own = origin_of(self.name)  # a foreigner calls itself by its name at home
        if not names.covers(own, name, wildcard=self.wildcard):
            raise Refused(
                f"this connection belongs to {shown(self.name)}, it cannot act as another"
            )
        if name == own:
            return self
        return replace(self, name=name, wildcard=False, certified=self.name)

    def may(self, right: Right, name: str) -> bool:
        """Whether a grant covers `right` on `name`.

        The authority's own node and the own masters see the graph without one.
        """
        if name.startswith(REMOTE) and is_alias(name):
            return self._may_elsewhere(right, name)
        if self.reach.covers(right, name):
            return self.exported is None or self._is_exported(right, name)
        return right is Right.GRAPH and (self.is_authority or self.is_own_master)

    def explain(self, right: Right, name: str) -> None:
        """Raise why `may` is false.

        Raises:
            HintedError: the reason.
        """
        if not is_alias(name):
            self.authorize(right, name)
            raise GrantMissing(f"{right.label} on {name} is not exported to this domain")
        origin = self._origin(right, name)
        if origin is not None:
            origin[0].authorize(right, origin[1])
        raise self._no_right_there(right, name)

    def hint_of(self, error: HintedError, right: Right, name: str) -> str:
        """What to do about a refusal that `explain` raised; depends on the arguments alone."""
        if not isinstance(error, GrantMissing) or self.is_foreign or is_alias(name):
            return error.hint
        # In an answer to thousands of calls each says it.
        return "; ".join((*error.near_misses[:_SAID], self.remedy(right, name)))

    def remedy(self, right: Right, name: str) -> str:
        """The commands that give the caller a right it lacks; `name` may be `/`: of all below."""
        if self.is_foreign or is_alias(name):
            return "ask its authority for a grant"
        node = self.certified or self.name
        ruled = rule_form(node, name.rstrip("/") or "/**", wildcard=self.has_tail)
        return remedy(node, right, ruled)

    def _no_right_there(self, right: Right, alias: str) -> HintedError:
        """Why grants do not even come into question: nothing is called so, or none was presented.

        Only a node of the own domain is told which labels there are.
        """
        missing = f"no grant for {right.label} on {shown(alias)}"
        try:
            found = None if self.is_foreign else split_alias(alias)
        except NameRefused:
            found = None
        if found is None:
            return GrantMissing(missing)
        domain = self.domain_of(found[0])
        if domain is None:
            return NotAdmitted(
                f"no domain is called {found[0]} here", "at the authority: rossec domain list"
            )
        if domain == OWN_DOMAIN:
            return GrantMissing(missing)
        if domain not in self.elsewhere:
            missing = f"{missing} by the authority of {domain}"
        return GrantMissing(missing, _ways(right, alias))

    def may_all_below(self, right: Right, namespace: str) -> bool:
        """Whether grants cover `right`, one of parameters, on every name below `namespace`."""
        if not is_alias(namespace):
            exported = self.exported is None or self.exported.covers_below(right, namespace)
            return exported and self.reach.covers_below(right, namespace)
        found = self._tree_origin(right, namespace)
        return found is not None and found[0].covers_below(right, found[1])

    def may_some_below(self, right: Right, namespace: str) -> bool:
        """Whether a grant covers `right`, one of parameters, at `namespace` or anywhere below."""
        if not is_alias(namespace):
            exported = self.exported is None or self.exported.touches(right, namespace)
            return exported and self.reach.touches(right, namespace)
        found = self._tree_origin(right, namespace)
        return found is not None and found[0].touches(right, found[1])

    def patterns(self, right: Right) -> int:
        """How many patterns must be matched one by one against each name."""
        others = self.elsewhere.values()
        return self.reach.patterns(right) + sum(each.reach.patterns(right) for each in others)

    @property
    def names_per_yield(self) -> int:
        """How many names a query checks between two yields: fewer where each costs more."""
        return max(1, NAMES_PER_YIELD // (1 + sum(map(self.patterns, Right)) // 8))

    def may_see(self, name: str) -> bool:
        """Whether a topic, service or node name may appear in an answer to this caller."""
        if self.is_authority or self.is_own_master:
            return True
        if name.startswith(REMOTE) and is_alias(name):
            return self._may_see_elsewhere(name)
        if not self.reach.covers_any(VISIBILITY_RIGHTS, name):
            return False
        return self.exported is None or self.exported.covers_any(ALL_RIGHTS, name)

    @property
    def has_slots(self) -> bool:
        """Whether any grant is for messages in slots."""
        return self.reach.has_slots and not (self.is_authority or self.is_own_master)

    def slot(self, name: str) -> int:
        """The seconds at whose multiples it is told who publishes `name`; 0: it is told at once.

        Its only right to see the name is then to subscribe it in slots.
        """
        if not self.has_slots or is_alias(name):
            return 0
        return self.reach.slot(VISIBILITY_RIGHTS, name)

    def _is_exported(self, right: Right, name: str) -> bool:
        exported = self.exported
        return exported is None or right in _NOT_EXPORTED or exported.covers(right, name)

    def _may_elsewhere(self, right: Right, alias: str) -> bool:
        if self.is_foreign:
            return False
        if right in _AT_HOME and self.reach.covers(right, alias):
            return True
        if right is Right.GRAPH and (self.is_authority or self.is_own_master):
            return True
        origin = self._origin(right, alias)
        return origin is not None and origin[0].reach.covers(right, origin[1])

    def _may_see_elsewhere(self, alias: str) -> bool:
        if self.is_foreign:
            return False
        if self.reach.covers(Right.GRAPH, alias):
            return True
        origin = self._origin(Right.GRAPH, alias)
        return origin is not None and origin[0].reach.covers_any(VISIBILITY_RIGHTS, origin[1])

    def _origin(self, right: Right, alias: str) -> tuple[OriginRights, str] | None:
        """The grants that decide on `alias`, and its name at the origin; None: there are none."""
        try:
            found = split_alias(alias)
        except NameRefused:
            return None
        if found is None or right not in _AT_ORIGIN or self.is_foreign:
            return None
        rights = self._rights_at(found[0])
        return None if rights is None else (rights, found[1])

    def _tree_origin(self, right: Right, namespace: str) -> tuple[Reach, str] | None:
        """As `_origin` for parameters; `/remote/LABEL` is the root of its origin."""
        label, slash, rest = namespace.removeprefix(f"{REMOTE}/").partition("/")
        if self.is_foreign or right is not Right.PARAM_GET or namespace == REMOTE:
            return None
        rights = self._rights_at(label)
        return None if rights is None else (rights.reach, f"{slash}{rest}" or "/")

    def _rights_at(self, label: str) -> OriginRights | None:
        domain = self.domain_of(label)
        if domain == OWN_DOMAIN:
            return OriginRights(self.reach, self.authorize)
        return None if domain is None else self.elsewhere.get(domain)


def _ways(right: Right, alias: str) -> tuple[str, ...]:
    """Who could give a right there: the same for every name, so it tells nothing of a gateway."""
    with suppress(NameRefused):
        if right is Right.SUBSCRIBE:
            own = f"or this one for subscribe on {served_name(alias)}, if a gateway serves it"
            return (f"ask its authority for a grant, {own}",)
    return ()
