"""A caller of the master and its rights at one time, and the rights lately denied. Pure, default deny.

A right on an alias (`/remote/LABEL/...`) is the right on the origin's name, from grants of the
origin's domain: a grant of the own one, whatever its pattern, gives no more there than `graph` and
`admin`, which concern the own master. Nothing below `/remote` is published, provided or set here. A
foreign caller has its alias as name, calls itself by its name at home, and sees no aliases: what
was imported is shown to no other domain.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, Protocol

from ca import names
from ca.errors import HintedError, NameRefused, NotAdmitted
from ca.names import REMOTE, is_alias, origin_of, served_name, shown, split_alias
from grants.decision import Reach
from grants.errors import GrantMissing
from grants.model import ALL_RIGHTS, Right
from grants.request import is_dispensable, own_form, remedy, rule_form
from rossec.master.state.registry import NodeRef

NAMES_PER_YIELD: Final = 64
VISIBILITY_RIGHTS: Final = Right.PUBLISH | Right.SUBSCRIBE | Right.CALL | Right.PROVIDE | Right.GRAPH
OWN_DOMAIN: Final = ""  # what a site of the own domain has as domain of its label
_AT_HOME: Final = Right.GRAPH | Right.ADMIN  # what own grants give on aliases
_AT_ORIGIN: Final = Right.SUBSCRIBE | Right.CALL | Right.PARAM_GET | Right.GRAPH
_NOT_EXPORTED: Final = Right.GRAPH | Right.ADMIN  # on the master itself; what is shown is bounded


class Refused(Exception):
    """The status text to answer with, after `rossec: `."""

    # `missing` is the right that is missing, and the name it is missing on, if that was the reason.
    def __init__(self, text: str, missing: tuple[Right, str] | None = None) -> None:
        super().__init__(text)
        self.missing = missing


@contextmanager
def refusals_answered() -> Iterator[None]:
    try:
        yield
    except HintedError as error:
        raise Refused(f"{error} ({error.hint})" if error.hint else str(error)) from error


class AddressTaken(Refused):
    """The address is registered by `owner`, which may be gone: only a probe can tell."""

    def __init__(self, owner: NodeRef) -> None:
        super().__init__("this address is registered by another node")
        self.owner = owner


class CertifiedPeer(Protocol):
    """A certified name, of a foreigner its alias, and the thumbprint of its key."""

    # A `ca.certificates.Identity` or a `NodeRef`.
    @property
    def name(self) -> str: ...

    @property
    def thumbprint(self) -> bytes: ...


_SAID: Final = 2  # near misses beside the command that gives the right
# Raises the `HintedError` that says why no valid grant covers a right on a name
Authorize = Callable[[Right, str], object]
# The trust domain of a label; `OWN_DOMAIN` for a site of the own one; None: no such label
DomainOf = Callable[[str], str | None]


class OriginRights(NamedTuple):
    reach: Reach
    authorize: Authorize


def no_domain(_label: str) -> str | None:
    return None


@dataclass(frozen=True)
class Caller:
    """A caller and its rights at one time, from the grants it presented."""

    # the certified name, of a foreigner its alias; within a call the name of the node, see `acting_as`
    name: str
    thumbprint: bytes  # of the certified key, to which grants are bound
    reach: Reach  # what its valid grants of the own domain cover
    authorize: Authorize  # called for a right on a name that `reach` does not cover
    wildcard: bool = False  # the certified name has a wildcard tail
    certified: str = ""  # the certified name where `name` is another one
    is_authority: bool = False  # it is the authority's own node, see `access_rules.is_authority`
    is_own_master: bool = False  # it is a listed master of the own domain
    # what its grants of foreign domains give, by trust domain
    elsewhere: Mapping[str, OriginRights] = field(default_factory=dict, hash=False)
    domain_of: DomainOf = no_domain  # resolves the labels of aliases
    # what a foreigner's domain is shown and given at all; None: what grants allow
    exported: Reach | None = None

    @property
    def display_name(self) -> str:
        name = shown(self.name)
        return f"{name} (certified as {self.certified})" if self.certified else name

    @property
    def identity(self) -> str:
        return shown(self.certified or self.name)

    @property
    def has_tail(self) -> bool:
        return self.wildcard or bool(self.certified)

    @property
    def is_foreign(self) -> bool:
        return is_alias(self.name)

    @property
    def has_rights(self) -> bool:
        """Whether anything but its certificate speaks for it: grants, or what it is."""
        if self.is_authority or self.is_own_master or not self.reach.is_empty:
            return True
        return any(not each.reach.is_empty for each in self.elsewhere.values())

    def acting_as(self, name: str) -> "Caller":
        if name == self.name and not name.startswith(REMOTE):  # the usual case
            return self
        own = origin_of(self.name)  # a foreigner calls itself by its name at home
        if not names.covers(own, name, wildcard=self.wildcard):
            raise Refused(f"this connection belongs to {shown(self.name)}, it cannot act as another")
        if name == own:
            return self
        return replace(self, name=name, wildcard=False, certified=self.name)

    def may(self, right: Right, name: str) -> bool:
        # Whether a grant covers `right` on `name`. The authority's own node and the own masters see the graph
        # without one.
        sees_all = right is Right.GRAPH and (self.is_authority or self.is_own_master)
        if not (name.startswith(REMOTE) and is_alias(name)):
            if self.reach.covers(right, name):
                exported = self.exported
                return exported is None or right in _NOT_EXPORTED or exported.covers(right, name)
            return sees_all
        # An alias: what was imported is shown to no other domain, and own grants give little on it.
        if self.is_foreign:
            return False
        if sees_all or (right in _AT_HOME and self.reach.covers(right, name)):
            return True
        origin = self._origin(right, name)
        return origin is not None and origin[0].reach.covers(right, origin[1])

    def explain(self, right: Right, name: str) -> None:
        """Raise why `may` is false."""
        # 1. An own name: no grant covers it, or one does and it is not shown to the caller's domain.
        if not is_alias(name):
            self.authorize(right, name)
            raise GrantMissing(f"{right.label} on {name} is not exported to this domain")
        # 2. A name of an origin whose grants the caller has.
        origin = self._origin(right, name)
        if origin is not None:
            origin[0].authorize(right, origin[1])
        # 3. Grants do not even come into question: nothing is called so, or none was presented. Only a
        #    node of the own domain is told which labels there are.
        missing = f"no grant for {right.label} on {shown(name)}"
        found, domain = None, None
        with suppress(NameRefused):
            found = None if self.is_foreign else split_alias(name)
        if found is not None:
            domain = self.domain_of(found[0])
            if domain is None:
                hint = "at the authority: rossec domain list"
                raise NotAdmitted(f"no domain is called {found[0]} here", hint)
        if domain is None or domain == OWN_DOMAIN:
            raise GrantMissing(missing)
        if domain not in self.elsewhere:
            missing = f"{missing} by the authority of {domain}"
        # Who could give it there: the same words for every name, so they tell nothing of a gateway.
        ways: tuple[str, ...] = ()
        with suppress(NameRefused):
            if right is Right.SUBSCRIBE:
                own = f"or this one for subscribe on {served_name(name)}, if a gateway serves it"
                ways = (f"ask its authority for a grant, {own}",)
        raise GrantMissing(missing, ways)

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

    def may_all_below(self, right: Right, namespace: str) -> bool:
        return self._below(Reach.covers_below, right, namespace)

    def may_some_below(self, right: Right, namespace: str) -> bool:
        return self._below(Reach.touches, right, namespace)

    def _below(self, covers: Callable[[Reach, Right, str], bool], right: Right, namespace: str) -> bool:
        # Whether grants cover a right of parameters on what is below a namespace.
        if not is_alias(namespace):
            exported = self.exported is None or covers(self.exported, right, namespace)
            return exported and covers(self.reach, right, namespace)
        if self.is_foreign or right is not Right.PARAM_GET or namespace == REMOTE:
            return False
        label, slash, rest = namespace.removeprefix(f"{REMOTE}/").partition("/")
        rights = self._rights_at(label)
        return rights is not None and covers(rights.reach, right, f"{slash}{rest}" or "/")

    def patterns(self, right: Right) -> int:
        others = self.elsewhere.values()
        return self.reach.patterns(right) + sum(each.reach.patterns(right) for each in others)

    @property
    def names_per_yield(self) -> int:
        return max(1, NAMES_PER_YIELD // (1 + sum(map(self.patterns, Right)) // 8))

    def may_see(self, name: str) -> bool:
        if self.is_authority or self.is_own_master:
            return True
        if not (name.startswith(REMOTE) and is_alias(name)):
            if not self.reach.covers_any(VISIBILITY_RIGHTS, name):
                return False
            return self.exported is None or self.exported.covers_any(ALL_RIGHTS, name)
        if self.is_foreign:
            return False
        if self.reach.covers(Right.GRAPH, name):
            return True
        origin = self._origin(Right.GRAPH, name)
        return origin is not None and origin[0].reach.covers_any(VISIBILITY_RIGHTS, origin[1])

    @property
    def has_slots(self) -> bool:
        return self.reach.has_slots and not (self.is_authority or self.is_own_master)

    def slot(self, name: str) -> int:
        # The seconds at whose multiples it is told who publishes `name`; 0: it is told at once. Its only
        # right to see the name is then to subscribe it in slots.
        if not self.has_slots or is_alias(name):
            return 0
        return self.reach.slot(VISIBILITY_RIGHTS, name)

    def _origin(self, right: Right, alias: str) -> tuple[OriginRights, str] | None:
        try:
            found = split_alias(alias)
        except NameRefused:
            return None
        if found is None or right not in _AT_ORIGIN or self.is_foreign:
            return None
        rights = self._rights_at(found[0])
        return None if rights is None else (rights, found[1])

    def _rights_at(self, label: str) -> OriginRights | None:
        domain = self.domain_of(label)
        if domain == OWN_DOMAIN:
            return OriginRights(self.reach, self.authorize)
        return None if domain is None else self.elsewhere.get(domain)


KEPT: Final = 24 * 3600  # seconds
MAX_DENIALS: Final = 1000
MAX_OF_NODE: Final = 200
MAX_NAME: Final = 255  # characters; a longer one is cut


class RecentDenial(NamedTuple):
    at: int
    node: str
    right: Right
    name: str


class RecentDenials:
    """The newest denials of all nodes, for a person to look at; in memory."""

    # Each right on a name counts once for a node, with the newest time and name: one run of an anonymous node
    # is as the next. Nodes choose the names, so the number is bounded, for each certified name and in all;
    # where the whole is full, the node with most entries loses its oldest: no node pushes out what another
    # was denied, unless many do it together.
    def __init__(self) -> None:
        self._nodes: dict[str, OrderedDict[tuple[Right, str], tuple[int, str]]] = {}
        self._count = 0

    def add(self, now: int, node: str, right: Right, name: str) -> None:
        """Record a denial, unless of what every program asks for and works without."""
        own = own_form(node, name)
        if is_dispensable(right, own):
            return
        denials = self._nodes.setdefault(node, OrderedDict())
        key = right, own[:MAX_NAME]
        if denials.pop(key, None) is None:
            self._count += 1
        denials[key] = now, name[:MAX_NAME]
        if len(denials) > MAX_OF_NODE:
            self._forget_oldest(node)
        while self._count > MAX_DENIALS:
            self._forget_oldest(max(self._nodes, key=lambda each: len(self._nodes[each])))

    def newest_first(self, now: int) -> list[RecentDenial]:
        self._drop_old(now)
        found = [
            RecentDenial(at, node, right, name)
            for node, denials in self._nodes.items()
            for (right, _), (at, name) in denials.items()
        ]
        return sorted(found, key=lambda denial: (-denial.at, denial[1:]))

    def _drop_old(self, now: int) -> None:
        for node in tuple(self._nodes):
            while node in self._nodes and now - next(iter(self._nodes[node].values()))[0] > KEPT:
                self._forget_oldest(node)

    def _forget_oldest(self, node: str) -> None:
        self._nodes[node].popitem(last=False)
        self._count -= 1
        if not self._nodes[node]:
            del self._nodes[node]
