"""The facts of other masters: checked, indexed by site, and how their names are written here. Pure.

A site is another master: another administration, or one that may be taken over. What it says is
checked as a node's registration is. A malformed fact refuses the site. A well-formed one that cannot
be used here, for example with an address on this host, is stored without effect: it may be withdrawn
later. Names of a foreign domain lie below its label; of another master of the own domain only the
names of nodes do: topics and services of one domain are one namespace (`ca.names`).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Final, NamedTuple, TypeAlias

from ca.errors import NameRefused
from ca.names import alias_of, check_label, check_name, is_alias, is_gateway, is_in_gateway, split_alias
from rossec.errors import ImportRefused
from rossec.master.state.registry import (
    ANY_TYPE,
    Endpoint,
    Kind,
    PublishersChanged,
    Registry,
    endpoint,
    is_connectable,
    is_reachable_from_here,
    is_type_name,
)

NODE: Final = "node"
TYPE: Final = "type"
PROVIDER: Final = "provider"


class Site(NamedTuple):
    """Another master."""

    label: str  # what it is called here; unique
    domain: str = ""  # the label of its foreign domain; empty: of the own domain
    on_this_host: bool = False  # it is followed over loopback, so its loopback addresses are this host's

    def check(self) -> "Site":
        """The site, if its labels are valid; raises NameRefused."""
        check_label(self.label)
        if self.domain:
            check_label(self.domain)
        return self

    @property
    def namespace(self) -> str:
        return self.domain or self.label

    def node(self, name: str) -> str:
        return alias_of(self.namespace, name)

    def key(self, name: str) -> str:
        return alias_of(self.domain, name) if self.domain else check_name(name)

    def origin(self, name: str) -> str | None:
        """The name at this site of what is called `name` here; None: it is not of this site."""
        try:
            alias = split_alias(name)
        except NameRefused:
            return None
        if alias is None:
            return None if self.domain else name
        return alias[1] if alias[0] == self.namespace else None


FACTS_LIMIT: Final = 65_536  # of one site
STEP: Final = 256  # facts that are taken over between two yields
_KINDS: Final = {kind.value: kind for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)}
_SCHEMES: Final = {NODE: "http", PROVIDER: "rosrpc"}

# Kind, name and value, as `rossec.master.api.graph_calls` has them; names are the origin's
Fact: TypeAlias = tuple[str, str, str]


class Address(NamedTuple):
    name: str
    uri: str
    endpoint: Endpoint


class Registered(NamedTuple):
    kind: Kind
    key: str


class SiteFacts:
    """What one site has said."""

    __slots__ = ("facts", "is_lost", "nodes", "providers", "registered", "settled", "site", "types")

    def __init__(self, site: Site) -> None:
        self.site: Final = site.check()
        self.facts: set[Fact] = set()  # as received
        # the addresses of its nodes, by their name at the origin, as far as usable here
        self.nodes: dict[str, Address] = {}
        self.registered: dict[str, set[Registered]] = {}  # for what its nodes are registered
        self.types: dict[str, str] = {}  # types, providers: of topics and services, by local name
        self.providers: dict[str, Address] = {}
        self.is_lost = False  # there is no connection with the site; its facts stay for now
        self.settled = -1  # the demand that its last complete answer was for (`WantedNames.version`)

    def registration(self, fact: Fact) -> Registered | None:
        # What a fact about a registration is about here; None: another fact, or not usable.
        kind = _KINDS.get(fact[0])
        key = None if kind is None else self.local_key(fact[1])
        if kind is None or key is None:
            return None
        # Below `/gateway` gateways alone publish and provide; its own master refuses others too.
        if is_in_gateway(key) and kind is not Kind.SUBSCRIBER and not is_gateway(fact[2]):
            return None
        return Registered(kind, key)

    def local_key(self, name: str) -> str | None:
        # The local name of a topic or service; None: it would be longer than a name.
        try:
            return self.site.key(name)
        except NameRefused:
            return None

    def keys(self, facts: Iterable[Fact]) -> set[str]:
        found = set[str]()
        for kind, name, _ in facts:
            if kind == NODE:
                found.update(each.key for each in self.registered.get(name, ()))
            elif (key := self.local_key(name)) is not None:
                found.add(key)
        return found

    def topics(self) -> list[str]:
        found = (each for registered in self.registered.values() for each in registered)
        return sorted({each.key for each in found if each.kind is not Kind.SERVICE})

    def add(self, fact: Fact) -> Registered | None:
        # Take a fact that is not held; returns the registration it is about.
        self.facts.add(fact)
        kind, name, value = fact
        if kind == NODE:
            with suppress(NameRefused):  # its alias would be longer than a name
                self._add_address(self.nodes, name, self.site.node(name), value)
            return None
        found = self.registration(fact)
        if found is not None:
            self.registered.setdefault(value, set()).add(found)
        elif (key := self.local_key(name)) is not None and kind == TYPE:
            self.types[key] = value
        elif key is not None and kind == PROVIDER:
            self._add_address(self.providers, key, key, value)
        return found

    def remove(self, fact: Fact) -> Registered | None:
        self.facts.remove(fact)
        kind, name, value = fact
        if kind == NODE:
            _remove_address(self.nodes, name, value)
            return None
        found = self.registration(fact)
        if found is not None:
            self.registered[value].discard(found)
            if not self.registered[value]:
                del self.registered[value]
        elif (key := self.local_key(name)) is not None and kind == TYPE:
            if self.types.get(key) == value:  # else there is a newer one
                del self.types[key]
        elif key is not None and kind == PROVIDER:
            _remove_address(self.providers, key, value)
        return found

    def _add_address(self, addresses: dict[str, Address], key: str, name: str, uri: str) -> None:
        place = endpoint(uri)
        if self.site.on_this_host or is_reachable_from_here(place[0]):
            addresses[key] = Address(name, uri, place)


def checked(facts: Iterable[Fact]) -> list[Fact]:
    return [_check(fact) for fact in facts]


def parts(facts: Iterable[Fact]) -> Iterator[list[Fact]]:
    rest = iter(facts)
    while part := list(islice(rest, STEP)):
        yield part


def _check(fact: Fact) -> Fact:
    kind, name, value = fact
    try:
        _check_name(name)
        if kind in _KINDS:
            _check_name(value)
            return fact
    except NameRefused as error:
        raise ImportRefused(f"a fact about an invalid name: {error}") from None
    scheme = _SCHEMES.get(kind)
    if scheme is not None and not is_connectable(value, scheme):
        raise ImportRefused(f"{name} has an address that is not one")
    if scheme is None and (kind != TYPE or not is_type_name(value)):
        raise ImportRefused(f"a fact of an unknown kind, or a type of {name} that is not one")
    return fact


def _check_name(name: str) -> None:
    if is_alias(check_name(name)):
        raise NameRefused(f"{name} is an alias at the origin itself", "a name travels one hop")


def _remove_address(addresses: dict[str, Address], key: str, uri: str) -> None:
    held = addresses.get(key)
    if held is not None and held.uri == uri:  # else there is a newer one
        del addresses[key]


class RetainedPublishers:
    """The publishers of lost sites, for the local subscribers that are connected to them."""

    # A dead master ends nothing between nodes: they judge each other without it. Its names go, but a list of
    # publishers without them would make subscribers disconnect. So a list keeps the addresses until the site
    # has answered again, or is followed no longer.
    def __init__(self) -> None:
        self._kept: dict[str, dict[str, Sequence[Address]]] = {}

    def keep(self, label: str, topic: str, found: Sequence[Address]) -> None:
        if found:
            self._kept.setdefault(label, {})[topic] = found

    def forget(self, label: str) -> None:
        self._kept.pop(label, None)

    def topics(self, label: str) -> tuple[str, ...]:
        return tuple(self._kept.get(label, ()))

    def addresses(self, topic: str) -> list[Address]:
        return [each for kept in self._kept.values() for each in kept.get(topic, ())]


MAX_REPORTED: Final = 1024  # contradictions of one site that are reported


@dataclass(frozen=True)
class TypeContradicted:
    """A topic is not imported from a site, where it has another type than here."""

    label: str
    topic: str
    type_here: str
    type_there: str


ImportEvent = PublishersChanged | TypeContradicted


@dataclass(frozen=True)
class SiteStatus:
    site: Site
    facts: int
    is_lost: bool
    topics: Callable[[], list[str]]


class Contradictions:
    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._reported: dict[str, set[str]] = {}

    def forget(self, label: str) -> None:
        self._reported.pop(label, None)

    def report(self, held: SiteFacts, facts: Iterable[Fact]) -> list[TypeContradicted]:
        # Those among `facts`, as far as not reported before.
        label, events = held.site.label, list[TypeContradicted]()
        reported = self._reported.setdefault(label, set())
        for kind, name, there in facts:
            topic = held.local_key(name) if kind == TYPE else None
            if topic is None or is_alias(topic):  # of an alias the origin's type counts
                continue
            here = self._registry.topic_type(topic)
            if here in (ANY_TYPE, there) or topic in reported:
                continue
            if len(reported) < MAX_REPORTED:
                reported.add(topic)
                events.append(TypeContradicted(label, topic, here, there))
        return events
