"""Which topics a gateway serves, from the graph of its master. Pure.

A topic counts that has a publisher of its origin. There is room for a limited number, which is
shared between the origins: one with many topics takes no room from the others. Within an origin
what is served already comes first, so that a new topic replaces none. An origin may show tens of
thousands of topics, and change them: what is done for each is done in steps, and messages pass
between them.
"""

from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from ca.domains.aliases import split_alias
from ca.domains.served import is_gateway, served_name
from ca.errors import NameRefused
from rossec.gateway.rules import TopicRule, covering
from rossec.participant.graph_view import Fact
from rossec.ros.names import ANY_TYPE

MAX_TOPICS: Final = 1024
BATCH: Final = 512  # facts or topics in one step


class Candidate(NamedTuple):
    """A topic that a rule covers and that has a publisher at its origin."""

    alias: str
    served: str
    rule: TopicRule
    type: str


class Observed(NamedTuple):
    """What the graph says of topics to serve.

    Args:
        candidates: by alias.
        servers: the gateways that are registered, by served name.
    """

    candidates: Mapping[str, Candidate]
    servers: Mapping[str, frozenset[str]]


def observing(facts: Iterable[Fact], rules: Sequence[TopicRule]) -> Generator[None, None, Observed]:
    """What `facts`, which may not change meanwhile, say; yields between the steps."""
    types, published = dict[str, str](), set[str]()
    servers: dict[str, frozenset[str]] = {}
    for count, (kind, name, value) in enumerate(facts, 1):
        if kind == "type":
            types[name] = value
        elif kind == "publisher" and is_gateway(value):
            servers[name] = servers.get(name, frozenset()) | {value}
        elif kind == "publisher" and _is_of_its_origin(name, value):
            published.add(name)
        if not count % BATCH:
            yield
    candidates = dict[str, Candidate]()
    for count, alias in enumerate(sorted(published), 1):
        found = _candidate(alias, rules, types.get(alias, ANY_TYPE))
        if found is not None:
            candidates[alias] = found
        if not count % BATCH:
            yield
    return Observed(candidates, servers)


def _is_of_its_origin(topic: str, node: str) -> bool:
    """Whether a topic is an alias, and the node one of the same domain."""
    try:
        one, other = split_alias(topic), split_alias(node)
    except NameRefused:
        return False
    return one is not None and other is not None and one[0] == other[0]


def _candidate(alias: str, rules: Sequence[TopicRule], type_name: str) -> Candidate | None:
    rule = covering(rules, alias)
    if rule is None:
        return None
    try:
        return Candidate(alias, served_name(alias), rule, type_name)
    except NameRefused:  # it would be longer than a name
        return None


def chosen(
    candidates: Iterable[Candidate], serving: Collection[str], most: int = MAX_TOPICS
) -> list[Candidate]:
    """Those of the candidates that there is room for.

    Args:
        serving: the aliases that are served already.
        most: how many may be served.
    """
    by_label: dict[str, list[Candidate]] = {}
    for each in candidates:
        by_label.setdefault(each.rule.label, []).append(each)
    taken, left = list[Candidate](), most
    queues = sorted(by_label.values(), key=len)
    for number, queue in enumerate(queues):
        share = left // (len(queues) - number)
        queue.sort(key=lambda each: (each.alias not in serving, each.alias))
        taken += queue[:share]
        left -= min(share, len(queue))
    return taken
