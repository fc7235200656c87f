"""The registrations of publishers, subscribers, services and parameter subscribers. Pure.

Answers as stock `rosmaster` (registrations.py) gives them, in its order. Rights are checked before
(`rossec.master.rights.access_rules`). A change of which nodes must be notified returns events; the
shell delivers them. Beyond stock: when a node is replaced or removed, the subscribers of its topics
are notified (stock leaves them with a dead publisher), and lookups by node are indexed. The master
connects to the addresses it is given, so these are validated and normalized (attack M8); that the
node listens there is proved by its key when it is called.
"""

import ipaddress
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache
from typing import Final, NamedTuple
from urllib.parse import urlsplit

# getaddrinfo takes 127.1, 0x7f000001 and 017700000001 for IPv4 addresses too (WHATWG URL, 3.5).
_NUMERIC_HOST: Final = re.compile(r"(?:.*\.)?(?:[0-9]+|0x[0-9a-f]*)\.?", re.IGNORECASE)
_LOCALHOST: Final = re.compile(r"(?:.*\.)?(?:localhost|localhost\.localdomain|ip6-localhost)\.?")
_BROADCAST: Final = "255.255.255.255"
URI_LIMIT: Final = 512
Endpoint = tuple[str, int | None]  # Host and port, normalized
_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
_CACHE_SIZE: Final = 256  # a node sends its own URIs in each call


@lru_cache(_CACHE_SIZE)
def endpoint(uri: str) -> Endpoint:
    """Host and port of a URI, normalized: equal for each spelling of one endpoint."""
    parts = urlsplit(uri)
    host = parts.hostname or ""
    address = _address(host)
    return (host.removesuffix(".") if address is None else str(address)), parts.port


@lru_cache(_CACHE_SIZE)
def is_connectable(uri: str, scheme: str) -> bool:
    """Whether `uri` is of `scheme`, and has a host and a port to connect to."""
    if len(uri) > URI_LIMIT or not uri.isascii() or not uri.isprintable() or " " in uri:
        return False
    try:
        parts = urlsplit(uri)
        port = parts.port
    except ValueError:
        return False
    host = parts.hostname or ""
    return parts.scheme == scheme and is_unicast_host(host) and bool(port) and "@" not in uri


def is_unicast_host(host: str) -> bool:
    address = _address(host)
    if address is None:
        return bool(host) and ":" not in host and _NUMERIC_HOST.fullmatch(host) is None
    return not (address.is_unspecified or address.is_multicast or str(address) == _BROADCAST)


def is_loopback_host(host: str) -> bool:
    address = _address(host)
    return _LOCALHOST.fullmatch(host) is not None if address is None else address.is_loopback


def is_reachable_from_here(host: str) -> bool:
    # Whether `host`, in an address that another host named, can be that host's. Loopback and link-local
    # addresses mean another machine here than there.
    address = _address(host)
    if address is None:
        return not is_loopback_host(host)
    return not (address.is_loopback or address.is_link_local)


def _address(host: str) -> _Address | None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return address if mapped is None else mapped


ANY_TYPE: Final = "*"
_TYPE_LIMIT: Final = 255
REGISTRATIONS_LIMIT: Final = 1024  # registrations of one kind of one node
NODES_LIMIT: Final = 64  # nodes of one key
REPLACED: Final = "new node registered with same name"


def is_type_name(value: str) -> bool:
    return value.count("/") == 1 and len(value) <= _TYPE_LIMIT and value.isprintable()


class Kind(Enum):
    """What a node can be registered as, for a name."""

    __hash__ = object.__hash__  # members are singletons; Enum's own is slower, in Python

    PUBLISHER = "publisher"
    SUBSCRIBER = "subscriber"
    SERVICE = "service"
    PARAMETER = "parameter subscriber"


class NodeRef(NamedTuple):
    """A registered node: its name, the URI of its slave API, and the key that registered it.

    The key belongs to the registration: while a certificate of an older key of the same name has
    not expired, two keys can call under one name, and only one of them is the registered node.
    """

    name: str
    uri: str
    thumbprint: bytes


@dataclass(frozen=True)
class PublishersChanged:
    """Notify `subscribers` that `topic` now has exactly these publishers."""

    topic: str
    subscribers: tuple[NodeRef, ...]
    publisher_uris: tuple[str, ...]


@dataclass(frozen=True)
class ShutdownNode:
    """Shut down the node at `node.uri`: another node has registered with its name."""

    node: NodeRef
    reason: str


Event = PublishersChanged | ShutdownNode


class Unregistered(NamedTuple):
    status: str
    removed: int


@dataclass
class _Node:
    ref: NodeRef
    keys: dict[Kind, dict[str, None]] = field(default_factory=lambda: {kind: {} for kind in Kind})


class Registry:
    """All registrations. Methods that change it return the events to deliver."""

    def __init__(self, nodes_limit: int = NODES_LIMIT) -> None:
        self.imported_publishers: Callable[[str], list[str]] = lambda _topic: []
        self.version = 0  # grows with every change, so equal versions mean equal state
        self._nodes: dict[str, _Node] = {}
        self._names: dict[Kind, dict[str, dict[str, None]]] = {kind: {} for kind in Kind}
        self._service_uris: dict[str, str] = {}
        self._types: dict[str, str] = {}
        self._owners: dict[Endpoint, str] = {}
        self._service_endpoints: Counter[Endpoint] = Counter()
        self._nodes_per_key: Counter[bytes] = Counter()
        self._silent: set[NodeRef] = set()
        self.nodes_limit = nodes_limit
        self._had_service = False

    def register_publisher(self, topic: str, type_name: str, node: NodeRef) -> list[Event]:
        """Register a publisher; its type, unless `*`, replaces that of subscribers."""
        events = self._register(Kind.PUBLISHER, topic, node)
        if type_name != ANY_TYPE or topic not in self._types:
            self._set_type(topic, type_name)
        return [*events, self.publishers_changed(topic)]

    def register_subscriber(self, topic: str, type_name: str, node: NodeRef) -> list[Event]:
        """Register a subscriber; its type counts only while the topic has none."""
        events = self._register(Kind.SUBSCRIBER, topic, node)
        if type_name != ANY_TYPE and topic not in self._types:
            imported = self.imported_publishers(topic)
            self._set_type(topic, type_name)
            if imported != self.imported_publishers(topic):  # some have another type
                events.append(self.publishers_changed(topic))
        return events

    def register_service(self, service: str, service_uri: str, node: NodeRef) -> list[Event]:
        """Register a service; the last provider to register replaces the one before."""
        for other in [name for name in self._names[Kind.SERVICE].get(service, ()) if name != node.name]:
            self._discard(Kind.SERVICE, service, other)
        events = self._register(Kind.SERVICE, service, node)
        if self._service_uris.get(service) != service_uri:
            self.version += 1
            self._drop_service_uri(service)
            self._service_uris[service] = service_uri
            self._service_endpoints[endpoint(service_uri)] += 1
        self._had_service = True
        return events

    def register_parameter(self, key: str, node: NodeRef) -> list[Event]:
        return self._register(Kind.PARAMETER, key, node)

    def unregister(self, kind: Kind, key: str, node: NodeRef) -> tuple[Unregistered, list[Event]]:
        """Remove a publisher, subscriber or parameter subscriber, if name, URI and key match."""
        known = self._nodes.get(node.name)
        if known is None:
            return Unregistered(f"[{node.name}] is not a registered node", 0), []
        if key not in known.keys[kind] or known.ref != node:
            return Unregistered(f"[{node.name}] is not a known provider of [{key}]", 0), []
        self._discard(kind, key, node.name)
        done = Unregistered(f"Unregistered [{node.name}] as provider of [{key}]", 1)
        return done, [self.publishers_changed(key)] if kind is Kind.PUBLISHER else []

    def unregister_service(
        self, service: str, name: str, service_uri: str, thumbprint: bytes
    ) -> Unregistered:
        node = self._nodes.get(name)
        if node is None or node.ref.thumbprint != thumbprint:
            return Unregistered(f"[{name}] is not a registered node", 0)
        if not self._had_service:
            return Unregistered(f"[{name}] is not a provider of [{service}]", 0)
        provided = name in self._names[Kind.SERVICE].get(service, ())
        if not provided or self._service_uris[service] != service_uri:
            text = f"[{service_uri}] is no longer the current service api handle for [{service}]"
            return Unregistered(text, 0)
        self._discard(Kind.SERVICE, service, name)
        return Unregistered(f"Unregistered [{name}] as provider of [{service}]", 1)

    def remove_node(self, name: str) -> list[Event]:
        node = self._nodes.get(name)
        if node is None:
            return []
        topics = list(node.keys[Kind.PUBLISHER])
        registered = [(kind, key) for kind, keys in node.keys.items() for key in keys]
        for kind, key in registered:
            self._discard(kind, key, name)
        return [self.publishers_changed(topic) for topic in topics]

    def remove(self, kind: Kind, key: str, name: str) -> list[Event]:
        """Remove one registration of a node, whatever its URI (a right was revoked)."""
        if not self.is_registered(kind, key, name):
            return []
        self._discard(kind, key, name)
        return [self.publishers_changed(key)] if kind is Kind.PUBLISHER else []

    def node_uri(self, name: str) -> str | None:
        node = self._nodes.get(name)
        return None if node is None else node.ref.uri

    def node(self, name: str) -> NodeRef | None:
        node = self._nodes.get(name)
        return None if node is None else node.ref

    def has_capacity(self, kind: Kind, key: str, node: NodeRef) -> bool:
        """Whether a node may register for `key`: it has done so, or is below the limits."""
        if not self.is_current(node):
            known = self._nodes.get(node.name)
            replaces = known is not None and known.ref.thumbprint == node.thumbprint
            return replaces or self._nodes_per_key[node.thumbprint] < self.nodes_limit
        keys = self._nodes[node.name].keys[kind]
        return key in keys or len(keys) < REGISTRATIONS_LIMIT

    def is_current(self, node: NodeRef) -> bool:
        known = self._nodes.get(node.name)
        return known is not None and known.ref == node

    def is_silent(self, node: NodeRef) -> bool:
        """Whether a registered node does not answer the master; only gateways are asked."""
        return node in self._silent

    @property
    def silent_names(self) -> frozenset[str]:
        return frozenset(node.name for node in self._silent)

    def set_silent(self, node: NodeRef, *, silent: bool) -> bool:
        """Note whether a registered node answers; returns whether that is news."""
        if not self.is_current(node) or silent is self.is_silent(node):
            return False
        (self._silent.add if silent else self._silent.discard)(node)
        self.version += 1
        return True

    def owner(self, uri: str) -> str | None:
        return self._owners.get(endpoint(uri))

    def is_registered_endpoint(self, place: Endpoint) -> bool:
        return place in self._owners or place in self._service_endpoints

    def providers_at(self, place: Endpoint) -> Iterator[NodeRef]:
        """The nodes that have a service at this host and port; mostly there is none."""
        if place in self._service_endpoints:
            found = [key for key, uri in self._service_uris.items() if endpoint(uri) == place]
            yield from (node for key in found for node in self.registered_nodes(Kind.SERVICE, key))

    def nodes(self) -> Iterator[NodeRef]:
        return (node.ref for node in self._nodes.values())

    def keys_of(self, name: str, kind: Kind) -> tuple[str, ...]:
        node = self._nodes.get(name)
        return () if node is None else tuple(node.keys[kind])

    def is_registered(self, kind: Kind, key: str, name: str) -> bool:
        return name in self._names[kind].get(key, ())

    def registered_nodes(self, kind: Kind, key: str) -> tuple[NodeRef, ...]:
        names = self._names[kind].get(key, ())
        return tuple(self._nodes[name].ref for name in names)

    def uris(self, kind: Kind, key: str) -> list[str]:
        return [node.uri for node in self.registered_nodes(kind, key)]

    def publisher_uris(self, topic: str) -> list[str]:
        return [*self.uris(Kind.PUBLISHER, topic), *self.imported_publishers(topic)]

    def publishers_changed(self, topic: str) -> PublishersChanged:
        subscribers = self.registered_nodes(Kind.SUBSCRIBER, topic)
        return PublishersChanged(topic, subscribers, tuple(self.publisher_uris(topic)))

    def entries(self, kind: Kind) -> Iterator[tuple[str, tuple[str, ...]]]:
        return ((key, tuple(names)) for key, names in tuple(self._names[kind].items()))

    def keys(self, kind: Kind) -> Collection[str]:
        return self._names[kind].keys()

    def service_uri(self, service: str) -> str | None:
        return self._service_uris.get(service)

    def topic_types(self) -> Iterable[tuple[str, str]]:
        return tuple(self._types.items())

    def topic_type(self, topic: str) -> str:
        return self._types.get(topic, ANY_TYPE)

    def _register(self, kind: Kind, key: str, ref: NodeRef) -> list[Event]:
        events: list[Event] = []
        old = self._nodes.get(ref.name)
        if old is not None and old.ref != ref:
            events = self.remove_node(ref.name)
            if old.ref.uri != ref.uri:  # else the new node itself listens there
                events.append(ShutdownNode(old.ref, REPLACED))
            old = None
        if old is None:
            self._nodes_per_key[ref.thumbprint] += 1
            self._owners[endpoint(ref.uri)] = ref.name
        node = self._nodes[ref.name] = old or _Node(ref)
        if key not in node.keys[kind]:
            node.keys[kind][key] = None
            self._names[kind].setdefault(key, {})[ref.name] = None
            self.version += 1
        return events

    def _discard(self, kind: Kind, key: str, name: str) -> None:
        self.version += 1
        node = self._nodes[name]
        del node.keys[kind][key]
        del self._names[kind][key][name]
        if not self._names[kind][key]:
            del self._names[kind][key]
            if kind is Kind.SERVICE:
                self._drop_service_uri(key)
            if not any(key in self._names[each] for each in (Kind.PUBLISHER, Kind.SUBSCRIBER)):
                self._types.pop(key, None)  # else one node could fill the memory with types
        if not any(node.keys.values()):
            del self._nodes[name]
            self._silent.discard(node.ref)
            self._nodes_per_key[node.ref.thumbprint] -= 1
            if self._nodes_per_key[node.ref.thumbprint] == 0:
                del self._nodes_per_key[node.ref.thumbprint]
            if self.owner(node.ref.uri) == name:
                del self._owners[endpoint(node.ref.uri)]

    def _drop_service_uri(self, service: str) -> None:
        uri = self._service_uris.pop(service, None)
        if uri is not None:
            place = endpoint(uri)
            self._service_endpoints[place] -= 1
            if self._service_endpoints[place] == 0:
                del self._service_endpoints[place]

    def _set_type(self, topic: str, type_name: str) -> None:
        self.version += self._types.get(topic) != type_name
        self._types[topic] = type_name
