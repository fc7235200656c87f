"""The facts of one site, checked and indexed. Pure.

A site is another administration, or a master that may be taken over: what it says is checked as a
node's registration is. A malformed fact refuses the site. A well-formed one that cannot be used
here, for example with an address on this host, is stored without effect: it may be withdrawn later.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from typing import Final, NamedTuple, TypeAlias

from ca.domains.aliases import is_alias
from ca.domains.served import is_gateway, is_in_gateway
from ca.errors import NameRefused
from ca.names import check_name
from rossec.errors import ImportRefused
from rossec.master.state.addresses import Endpoint, endpoint, is_connectable, is_reachable_from_here
from rossec.master.state.registry import Kind
from rossec.master.state.sites import NODE, PROVIDER, TYPE, Site

FACTS_LIMIT: Final = 65_536  # of one site
STEP: Final = 256  # facts that are taken over between two yields
_TYPE_LIMIT: Final = 255
_KINDS: Final = {kind.value: kind for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)}
_SCHEMES: Final = {NODE: "http", PROVIDER: "rosrpc"}

Fact: TypeAlias = tuple[str, str, str]
"""Kind, name and value, as `rossec.master.api.watch_calls` has them; names are the origin's."""


class Address(NamedTuple):
    """The local name of a node or service, its URI, and its normalized host and port."""

    name: str
    uri: str
    endpoint: Endpoint


class Registered(NamedTuple):
    """One registration: as what, and for which local name."""

    kind: Kind
    key: str


class SiteFacts:
    """What one site has said.

    Attributes:
        facts: as received.
        nodes: the addresses of its nodes, by their name at the origin, as far as usable here.
        registered: for what its nodes are registered.
        types, providers: of topics and services, by local name.
        is_lost: there is no connection with the site; its facts stay for now.
        settled: the demand that its last complete answer was for (`Demand.version`).
    """

    __slots__ = ("facts", "is_lost", "nodes", "providers", "registered", "settled", "site", "types")

    def __init__(self, site: Site) -> None:
        self.site: Final = site.check()
        self.facts: set[Fact] = set()
        self.nodes: dict[str, Address] = {}
        self.registered: dict[str, set[Registered]] = {}
        self.types: dict[str, str] = {}
        self.providers: dict[str, Address] = {}
        self.is_lost = False
        self.settled = -1

    def registration(self, fact: Fact) -> Registered | None:
        """What a fact about a registration is about here; None: another fact, or not usable."""
        kind = _KINDS.get(fact[0])
        key = None if kind is None else self.local_key(fact[1])
        if kind is None or key is None or (is_in_gateway(key) and not _may_offer(kind, fact[2])):
            return None
        return Registered(kind, key)

    def local_key(self, name: str) -> str | None:
        """The local name of a topic or service; None: it would be longer than a name."""
        try:
            return self.site.key(name)
        except NameRefused:
            return None

    def keys(self, facts: Iterable[Fact]) -> set[str]:
        """The local names that facts are about; those of a node's registrations for the node."""
        found = set[str]()
        for kind, name, _ in facts:
            if kind == NODE:
                found.update(each.key for each in self.registered.get(name, ()))
            elif (key := self.local_key(name)) is not None:
                found.add(key)
        return found

    def topics(self) -> list[str]:
        """The topics that its nodes publish or subscribe, by their local names."""
        found = (each for registered in self.registered.values() for each in registered)
        return sorted({each.key for each in found if each.kind is not Kind.SERVICE})

    def add(self, fact: Fact) -> Registered | None:
        """Take a fact that is not held; returns the registration it is about."""
        self.facts.add(fact)
        kind, name, value = fact
        if kind == NODE:
            self._add_node(name, value)
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
        """Withdraw a fact that is held; returns the registration it was about."""
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

    def _add_node(self, name: str, uri: str) -> None:
        with suppress(NameRefused):  # its alias would be longer than a name
            self._add_address(self.nodes, name, self.site.node(name), uri)

    def _add_address(self, addresses: dict[str, Address], key: str, name: str, uri: str) -> None:
        place = endpoint(uri)
        if self.site.on_this_host or is_reachable_from_here(place[0]):
            addresses[key] = Address(name, uri, place)


def checked(facts: Iterable[Fact]) -> list[Fact]:
    """The facts, if each is well-formed.

    Raises:
        ImportRefused: an unknown kind, an invalid name, type or address, or an alias: a name
            travels one hop.
    """
    return [_check(fact) for fact in facts]


def parts(facts: Iterable[Fact]) -> Iterator[list[Fact]]:
    """The facts, `STEP` at once."""
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
    if scheme is None and (kind != TYPE or not _is_type(value)):
        raise ImportRefused(f"a fact of an unknown kind, or a type of {name} that is not one")
    return fact


def _may_offer(kind: Kind, node: str) -> bool:
    """Whether a node may be registered so below `/gateway`, which its own master refuses too."""
    return kind is Kind.SUBSCRIBER or is_gateway(node)


def _check_name(name: str) -> None:
    if is_alias(check_name(name)):
        raise NameRefused(f"{name} is an alias at the origin itself", "a name travels one hop")


def _is_type(value: str) -> bool:
    return value.count("/") == 1 and len(value) <= _TYPE_LIMIT and value.isprintable()


def _remove_address(addresses: dict[str, Address], key: str, uri: str) -> None:
    held = addresses.get(key)
    if held is not None and held.uri == uri:  # else there is a newer one
        del addresses[key]
