"""The call by which another master follows this one: `rossec.followSite`. Pure.

It is answered with what is registered at this master itself, never with what is imported: a fact
travels one hop, so no loop can arise. A master of the own domain is shown every fact, as it is
trusted for addresses; anybody else what it has `graph` on, a foreigner only what is exported to its
domain. Only what the follower wants is sent (docs/spec/multimaster.md).
"""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from ca.domains.aliases import is_alias
from ca.domains.served import is_in_gateway
from grants.model import ALL_RIGHTS, Permission, Right
from grants.reach import Reach
from rossec.master.api import arguments as arg
from rossec.master.api.graph_views import Fact, GraphViews
from rossec.master.api.methods import CallRequest, Method, Methods, Reply, Steps
from rossec.master.rights.caller import Caller, Refused
from rossec.master.state.demand import MAX_WANTED
from rossec.master.state.registry import ANY_TYPE, Kind, Registry

FOLLOW: Final = "rossec.followSite"
MAX_PATTERNS: Final = 64  # wanted, with a wildcard before their end: each costs with each name

UNCHANGED: Final[tuple[int, str, dict[str, object]]] = (1, "", {})
"""The answer after a wait without a change; short, as there are many in a silent mesh."""

Digests = Callable[[], tuple[bytes, bytes]]
"""Of the own revocation list and of the list of domains; empty: there is none."""

_KINDS: Final = (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)


class SiteCalls:
    """The handler over the own registrations.

    Args:
        instance: identifies this run of the master.
        digests: of the lists that this master holds.
    """

    def __init__(self, registry: Registry, instance: str, digests: Digests) -> None:
        self._registry = registry
        self._digests = digests
        self.views: Final = GraphViews(instance)

    def methods(self) -> Methods:
        """The entry of the method table."""
        checks = (arg.text("instance"), arg.number("cursor"), arg.patterns("wanted", MAX_WANTED))
        return {FOLLOW: Method(checks, {}, self._follow)}

    def _follow(self, request: CallRequest) -> Steps:
        wanted = _wanted(request.arguments[3])
        return self._reply(request, wanted)

    def _reply(self, request: CallRequest, wanted: Reach | None) -> Steps:
        seen, at_once = set[Fact](), request.caller.names_per_yield
        found = own_facts(self._registry, request.caller, wanted)
        for checked, fact in enumerate(found, 1):
            if fact is not None:
                seen.add(fact)
            if not checked % at_once:
                yield
        known = request.arguments[1], request.arguments[2]
        key, version = request.caller.thumbprint, self._registry.version
        revocations, domains = self._digests()
        lists = revocations, b"" if request.caller.is_foreign else domains
        # an answer to other wants is one at once: the follower waits for it, also if it is no
        beside = (*lists, _digest(request.arguments[3]))
        answer = self.views.answer(key, known, frozenset(seen), version, beside)
        answer |= {"revocations": lists[0], "domains": lists[1]}
        return Reply(answer, "facts of this site")


def own_facts(registry: Registry, caller: Caller, wanted: Reach | None) -> Iterator[Fact | None]:
    """The facts registered here that `caller` may see and wants.

    None for each name that is not shown. `wanted` None: everything.
    """
    nodes = set[str]()
    for kind in _KINDS:
        for key, names in registry.entries(kind):
            own = [name for name in names if not is_alias(name)]
            if is_in_gateway(key):
                silent = registry.silent_names
                own = [name for name in own if name not in silent]
            if not own or not _is_shown(caller, wanted, key):
                yield None
                continue
            nodes.update(own)
            yield from ((kind.value, key, name) for name in own)
            if kind is Kind.SERVICE:
                yield "provider", key, registry.service_uri(key) or ""
            elif registry.topic_type(key) != ANY_TYPE:
                yield "type", key, registry.topic_type(key)
    for node in tuple(registry.nodes()):
        shown = node.name in nodes or _is_shown(caller, wanted, node.name)
        yield ("node", node.name, node.uri) if shown else None


def _is_shown(caller: Caller, wanted: Reach | None, name: str) -> bool:
    """An alias is not shown: it is a name of another origin."""
    if is_alias(name) or (wanted is not None and not wanted.covers(Right.GRAPH, name)):
        return False
    exported = caller.exported is None or caller.exported.covers_any(ALL_RIGHTS, name)
    return exported and caller.may(Right.GRAPH, name)


def _digest(wanted: object) -> bytes:
    return hashlib.sha256(repr(wanted).encode()).digest()


def _wanted(value: object) -> Reach | None:
    """What is wanted, as a set of patterns; None: everything. The empty name wants nothing."""
    names: Sequence[object] = value if isinstance(value, list) else ()
    if not names:
        return None
    given = [Permission(name, Right.GRAPH) for name in names if isinstance(name, str) and name]
    reach = Reach(given)
    if reach.patterns(Right.GRAPH) > MAX_PATTERNS:
        raise Refused(
            f"more than {MAX_PATTERNS} wanted patterns have a wildcard before their end: "
            "want everything, with an empty list"
        )
    return reach
