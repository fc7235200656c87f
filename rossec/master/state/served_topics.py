"""What gateways serve now, of the own registrations and of other masters of the domain. Pure.

A gateway is an ordinary publisher of served names (`ca.domains.served`). One that does not answer
the master serves nothing while that lasts: its registrations stay, `Registry.is_silent` says so.
Those of other masters serve where none does here, and then one of them: from two a subscriber would
get each message twice.
"""

from collections.abc import Mapping
from typing import NamedTuple

from ca.domains.served import alias_of_served, is_in_gateway, served_name
from ca.errors import NameRefused
from grants.model import Right
from rossec.master.state.imports import Imports
from rossec.master.state.registry import ANY_TYPE, Kind, Registry


class ServedTopics:
    """Queries by alias."""

    def __init__(self, registry: Registry, imports: Imports) -> None:
        self._registry = registry
        self._imports = imports
        self._found = _Found((-1, -1), {})

    def uris(self, alias: str) -> list[str]:
        """The slave API URIs of the gateways that serve an alias."""
        served = _served(alias)
        if served is None or not self._is_taken(alias):
            return []
        nodes = self._registry.registered_nodes(Kind.PUBLISHER, served)
        own = [node.uri for node in nodes if not self._registry.is_silent(node)]
        return own or self._imports.publisher_uris(served)[:1]

    def gateways(self) -> Mapping[str, tuple[str, ...]]:
        """Every alias that is served, with the names of its gateways; empty without any."""
        version = self._registry.version, self._imports.version
        if self._found.version != version:
            self._found = _Found(version, self._find())
        return self._found.gateways

    def topic_type(self, alias: str) -> str:
        """The type of what is served of an alias, `*` while it is unknown."""
        served = _served(alias)
        if served is None:
            return ANY_TYPE
        own = self._registry.topic_type(served)
        return self._imports.topic_type(served) if own == ANY_TYPE else own

    def _find(self) -> dict[str, tuple[str, ...]]:
        own, imported = self._registry.keys(Kind.PUBLISHER), self._imports.keys(Kind.PUBLISHER)
        keys = dict.fromkeys(key for keys in (own, imported) for key in keys if is_in_gateway(key))
        found = ((alias_of_served(key), self._names(key)) for key in keys)
        served = ((alias, names) for alias, names in found if alias is not None and names)
        return {alias: names for alias, names in served if self._is_taken(alias)}

    def _is_taken(self, alias: str) -> bool:
        """Whether the list of domains lets it be subscribed here at all, by whom ever."""
        return self._imports.intake.gives(Right.SUBSCRIBE, alias)

    def _names(self, served: str) -> tuple[str, ...]:
        nodes = self._registry.registered_nodes(Kind.PUBLISHER, served)
        own = tuple(node.name for node in nodes if not self._registry.is_silent(node))
        return own or self._imports.nodes_of(Kind.PUBLISHER, served)[:1]


class _Found(NamedTuple):
    """The gateways by alias, and the versions of registry and imports that this was found in."""

    version: tuple[int, int]
    gateways: Mapping[str, tuple[str, ...]]


def _served(alias: str) -> str | None:
    try:
        return served_name(alias)
    except NameRefused:
        return None
