"""What other masters have registered, as a layer over the own registrations. Pure.

Own facts always win: a service that is registered here is not imported, nor a topic from a site
that gives it another type. Of several sites the one with the lower label wins. What wins is decided
when it is asked, so a fact that was hidden appears by itself when what hid it goes. What is imported
is never exported, and nothing below `/remote` can be registered, so a fact travels one hop and no
loop can arise. The master never calls an imported node. Names are local here (`Site`).
"""

from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Final

from ca.bounded import Newest
from ca.errors import NameRefused
from ca.names import REMOTE, alias_of_served, is_alias, served_name, split_alias
from grants.decision import Reach
from grants.model import ALL_RIGHTS, Right
from rossec.errors import ImportRefused
from rossec.master.state.imported_facts import (
    FACTS_LIMIT,
    Address,
    Contradictions,
    Fact,
    ImportEvent,
    RetainedPublishers,
    Site,
    SiteFacts,
    SiteStatus,
    checked,
    parts,
)
from rossec.master.state.parameters import Mirrors
from rossec.master.state.registry import ANY_TYPE, Kind, PublishersChanged, Registry
from rossec.ros.xmlrpc import run_out

WANTED_SECONDS: Final = 60
MAX_WANTED: Final = 4096  # names in one call; more is everything
MAX_WANTED_BYTES: Final = 256 * 1024
EVERYTHING: Final[tuple[str, ...]] = ()
NOTHING: Final = ("",)  # the empty name matches nothing


class WantedNames:
    """The names that local nodes want of other masters, as local names; `version` grows with them."""

    # Facts travel by need, as in the thesis (chapter 6). Wanted is what local nodes subscribe, and for a
    # minute what they looked up; a tool that lists the graph wants everything for a minute. While a name is
    # wanted its sites report changes, so a further lookup is answered at once, also with no.
    def __init__(self, registry: Registry) -> None:
        self.version = 0
        self._registry = registry
        self._asked: Newest[str, int] = Newest(MAX_WANTED)  # until when
        self._everything_until = 0

    def ask(self, name: str, now: int) -> None:
        is_subscribed = len(self._registry.registered_nodes(Kind.SUBSCRIBER, name)) > 1  # by others
        if self._asked.get(name, 0) <= now and not is_subscribed:
            self.version += 1
        self._asked[name] = now + WANTED_SECONDS

    def ask_everything(self, now: int) -> None:
        if self._everything_until <= now:
            self.version += 1
        self._everything_until = now + WANTED_SECONDS

    def wanted(self, site: Site, now: int) -> tuple[str, ...]:
        if now < self._everything_until:
            return EVERYTHING
        found = {name for name in map(site.origin, self._names(now)) if name is not None}
        if len(found) > MAX_WANTED or sum(map(len, found)) > MAX_WANTED_BYTES:
            return EVERYTHING
        return tuple(sorted(found)) or NOTHING

    def _names(self, now: int) -> Iterator[str]:
        for name in self._registry.keys(Kind.SUBSCRIBER):
            yield name
            if is_alias(name):  # a gateway registered at another master of the domain serves it too
                with suppress(NameRefused):
                    yield served_name(name)
        for name in [name for name, until in self._asked.items() if until <= now]:
            del self._asked[name]
        yield from self._asked


# What is taken from the foreign domain with a label, as names there; None: all it shows
Rules = Callable[[str], Reach | None]


class ImportFilter:
    """What is taken from foreign domains into the own graph, as the list of domains says."""

    # It is asked with every query, so another list counts at once, for what was imported before too. A right
    # decides on what it is used for: `subscribe` on the addresses of a topic's publishers, `call` on that of
    # a service, `param-get` on a mirrored parameter; to be seen in the graph, any right does.
    def __init__(self, rules: Rules = lambda _label: None) -> None:
        self.rules = rules

    def shows(self, name: str) -> bool:
        return self.gives(ALL_RIGHTS, name)

    def shows_node(self, alias: str, registered: Iterable[str]) -> bool:
        return self.shows(alias) or any(map(self.shows, registered))

    def gives(self, rights: Right, name: str) -> bool:
        if not name.startswith(REMOTE):
            return True
        try:
            found = split_alias(name)
        except NameRefused:
            return False
        if found is None:
            return True
        reach = self.rules(found[0])
        return reach is None or reach.covers_any(rights, found[1])


MAX_REGISTERED: Final = 1024  # nodes of a site for one name; each update has all addresses

_Entry = tuple[str, str]  # The label of a site, and the name there of a node


class Imports:
    """The facts of all sites."""

    def __init__(self, registry: Registry, limit: int = FACTS_LIMIT) -> None:
        self.version = 0  # grows with every change
        self.demand: Final = WantedNames(registry)  # what local nodes want of the sites
        self.mirrors: Final = Mirrors()  # parameters of the sites
        self.filter: Final = ImportFilter()  # what is taken from foreign domains at all
        self.on_settled: Callable[[], object] = lambda: None  # called when `is_settled` has become true
        self.registry: Final = registry  # the own registrations: their events name the imported too
        self._limit = limit  # facts of one site
        self._sites: dict[str, SiteFacts] = {}
        self._entries: dict[Kind, dict[str, dict[_Entry, None]]] = {kind: {} for kind in Kind}
        self._contradictions = Contradictions(registry)
        self._retained: Final = RetainedPublishers()
        registry.imported_publishers = self.publisher_uris

    def apply(
        self, site: Site, added: Iterable[Fact], removed: Iterable[Fact], *, whole: bool = False
    ) -> list[ImportEvent]:
        """Take over a complete answer of a site, at once; as `apply_in_steps`."""
        return run_out(self.apply_in_steps(site, added, removed, whole=whole))

    def apply_in_steps(
        self, site: Site, added: Iterable[Fact], removed: Iterable[Fact], *, whole: bool = False
    ) -> Generator[None, None, list[ImportEvent]]:
        # Take over a complete answer of a site: nothing takes effect if it is refused. Yields where other
        # calls may be answered, and returns the events. One answer of a site is taken over at a time; `drop`
        # ends it. Another site with this label takes its place; `whole`: `added` is all that the site has.
        held = self._sites.get(site.label)
        old = held.facts if held is not None and held.site == site else set[Fact]()
        new = set[Fact]()
        for part in parts(added):
            new.update(checked(part))
            yield
        gone = old - new if whole else old.intersection(removed) - new
        new -= old
        if len(old) - len(gone) + len(new) > self._limit:
            raise ImportRefused(f"site {site.label} has more than {self._limit} facts")
        events = self.drop(site.label) if held is not None and held.site != site else []
        held = self._sites.setdefault(site.label, SiteFacts(site))
        held.is_lost = False
        events += yield from self._change(held, new, gone)
        events += self._forget_retained(site.label)
        return [*events, *self._contradictions.report(held, new)]

    def lose(self, label: str) -> None:
        """There is no connection with a site: its facts stay, marked."""
        if label in self._sites:
            self._sites[label].is_lost = True
            self._report_settled()

    def expire(self, label: str) -> None:
        """A site is lost for too long: forget its facts, but let nobody leave its publishers."""
        if (held := self._sites.get(label)) is not None:
            for topic in self._followed_topics(held, held.facts):
                used = self._used(Kind.PUBLISHER, topic)
                found = [held.nodes[node] for each, node in used if each == label]
                self._retained.keep(label, topic, found)
            self._forget(held)

    def drop(self, label: str) -> list[ImportEvent]:
        """Forget a site, its facts, and what `expire` kept of it."""
        held = self._sites.get(label)
        events = [] if held is None else self._forget(held)
        return [*events, *self._forget_retained(label)]

    def _forget(self, held: SiteFacts) -> list[PublishersChanged]:
        label, topics = held.site.label, self._followed_topics(held, held.facts)
        before = {topic: self.publisher_uris(topic) for topic in topics}
        for fact in tuple(held.facts):
            self._remove(held, fact)
        del self._sites[label]
        self.version += 1
        self._contradictions.forget(label)
        self._report_settled()
        return self._changed(before)

    def _forget_retained(self, label: str) -> list[PublishersChanged]:
        before = {topic: self.publisher_uris(topic) for topic in self._retained.topics(label)}
        self._retained.forget(label)
        return self._changed(before)

    def taken_anew(self) -> list[PublishersChanged]:
        # What is taken from foreign domains may have changed: the subscribers there are told.
        self.version += 1
        topics = [topic for topic in self.registry.keys(Kind.SUBSCRIBER) if is_alias(topic)]
        return [self.registry.publishers_changed(topic) for topic in topics]

    def settle(self, label: str, demand: int) -> None:
        """A site has answered completely what was wanted when the demand had this version."""
        if label in self._sites:
            self._sites[label].settled = demand
            self._report_settled()

    @property
    def is_settled(self) -> bool:
        demand = self.demand.version
        return all(held.is_lost or held.settled >= demand for held in self._sites.values())

    @property
    def sites(self) -> tuple[SiteStatus, ...]:
        found = (self._sites[label] for label in sorted(self._sites))
        return tuple(SiteStatus(it.site, len(it.facts), it.is_lost, it.topics) for it in found)

    def own_sites(self) -> Collection[str]:
        return [label for label, held in self._sites.items() if not held.site.domain]

    def keys(self, kind: Kind) -> Collection[str]:
        return self._entries[kind].keys()

    def nodes_of(self, kind: Kind, key: str) -> tuple[str, ...]:
        found = self._used(kind, key)
        return tuple(dict.fromkeys(self._sites[label].nodes[node].name for label, node in found))

    def publisher_uris(self, topic: str) -> list[str]:
        """The slave API URIs of the imported publishers of a topic, and of those kept."""
        if not self.filter.gives(Right.SUBSCRIBE, topic):
            return []
        found = [self._sites[each].nodes[name] for each, name in self._used(Kind.PUBLISHER, topic)]
        kept = [each for each in self._retained.addresses(topic) if self._is_elsewhere(each)]
        return list(dict.fromkeys(address.uri for address in (*found, *kept)))

    def service_uri(self, service: str) -> str | None:
        if not self.filter.gives(Right.CALL, service):
            return None
        for label, _ in self._used(Kind.SERVICE, service):
            return self._sites[label].providers[service].uri
        return None

    def topic_type(self, topic: str) -> str:
        used = (*self._used(Kind.PUBLISHER, topic), *self._used(Kind.SUBSCRIBER, topic))
        types = (self._sites[label].types.get(topic) for label, _ in sorted(used))
        return next((name for name in types if name is not None), ANY_TYPE)

    def node_uri(self, alias: str) -> str | None:
        found = self._find(alias)
        return None if found is None else found[0].nodes[found[1]].uri

    def nodes(self) -> Iterator[tuple[str, str]]:
        for label in sorted(self._sites):
            held = self._sites.get(label)
            for address in () if held is None else tuple(held.nodes.values()):
                found = self._find(address.name)
                if found is not None and found[0] is held:
                    yield address.name, found[0].nodes[found[1]].uri

    def keys_of(self, alias: str, kind: Kind) -> tuple[str, ...]:
        found = self._find(alias)
        if found is None:
            return ()
        held, name = found
        return tuple(each.key for each in held.registered.get(name, ()) if each.kind is kind)

    def _report_settled(self) -> None:
        if self.is_settled:
            self.on_settled()

    def _find(self, alias: str) -> tuple[SiteFacts, str] | None:
        for label in sorted(self._sites):
            held = self._sites[label]
            if not alias.startswith(f"/remote/{held.site.namespace}/"):
                continue
            name = held.site.origin(alias)
            if name is not None and self._is_used(held, name):
                return held, name
        return None

    def _is_used(self, held: SiteFacts, name: str) -> bool:
        # Whether a node has an address, which is not one of this master's own nodes.
        address = held.nodes.get(name)
        if address is None or self.registry.is_registered_endpoint(address.endpoint):
            return False
        if not held.site.domain:
            return self.registry.node(name) is None
        keys = (each.key for each in held.registered.get(name, ()))
        return self.filter.shows_node(address.name, keys)

    def _used(self, kind: Kind, key: str) -> list[_Entry]:
        entries = self._entries[kind].get(key)
        if not entries or not self.filter.shows(key):
            return []
        if kind is Kind.SERVICE:
            if self.registry.service_uri(key) is not None:
                return []
            for label, node in sorted(entries):
                held = self._sites[label]
                address = held.providers.get(key)
                if address is not None and self._is_elsewhere(address) and self._is_used(held, node):
                    return [(label, node)]
            return []
        found = [each for each in sorted(entries) if self._is_used(self._sites[each[0]], each[1])]
        # The type that counts: the own one, but of an alias the origin decides, not who subscribes it here.
        type_name = ANY_TYPE if is_alias(key) else self.registry.topic_type(key)
        if type_name == ANY_TYPE:
            labels = {label for kind in _TOPIC_KINDS for label, _ in self._entries[kind].get(key, ())}
            types = (self._sites[label].types.get(key) for label in sorted(labels))
            type_name = next((name for name in types if name is not None), ANY_TYPE)
        return [each for each in found if (self._sites[each[0]].types.get(key, type_name) == type_name)]

    def _is_elsewhere(self, address: Address) -> bool:
        return not self.registry.is_registered_endpoint(address.endpoint)

    def _change(
        self, held: SiteFacts, new: set[Fact], gone: set[Fact]
    ) -> Generator[None, None, list[PublishersChanged]]:
        if not new and not gone:
            return []
        topics = self._followed_topics(held, new | gone)
        before = {topic: self.publisher_uris(topic) for topic in topics}
        for change, facts in ((self._remove, gone), (self._add, new)):
            for part in parts(facts):
                for fact in part:
                    change(held, fact)
                self.version += 1
                yield
                if self._sites.get(held.site.label) is not held:
                    return self._changed(before)
        return self._changed(before)

    def _changed(self, before: Mapping[str, list[str]]) -> list[PublishersChanged]:
        return [
            self.registry.publishers_changed(topic)
            for topic, uris in before.items()
            if self.publisher_uris(topic) != uris
        ]

    def _add(self, held: SiteFacts, fact: Fact) -> None:
        found = held.add(fact)
        if found is not None:
            entries = self._entries[found.kind].setdefault(found.key, {})
            if sum(label == held.site.label for label, _ in entries) < MAX_REGISTERED:
                entries[held.site.label, fact[2]] = None

    def _remove(self, held: SiteFacts, fact: Fact) -> None:
        found = held.remove(fact)
        if found is not None:
            entries = self._entries[found.kind].get(found.key, {})
            entries.pop((held.site.label, fact[2]), None)
            if not entries:
                self._entries[found.kind].pop(found.key, None)

    def _followed_topics(self, held: SiteFacts, changes: Iterable[Fact]) -> list[str]:
        followed = self.registry.keys(Kind.SUBSCRIBER)
        found = held.keys(changes) if followed else set[str]()
        return sorted(k for k in found if k in followed or alias_of_served(k) in followed)


_TOPIC_KINDS: Final = (Kind.PUBLISHER, Kind.SUBSCRIBER)
