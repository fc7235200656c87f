"""The calls of the own relays: doors to open here, and where a target of another site is. Pure.

A relay connects for another site to what `rossec.relayTarget` answers and to nothing else: what is
registered at this master itself and shown to that site's domain. A name that is unknown and one
that is not shown are refused alike, as the other relay may ask for any.
"""

from typing import Final

from ca.domains.aliases import is_alias
from grants.model import ALL_RIGHTS
from grants.reach import Reach
from rossec.master.api import relay_arguments as arg
from rossec.master.api.arguments import number, text
from rossec.master.api.methods import CallRequest, Method, Methods, Reply
from rossec.master.rights.caller import Refused
from rossec.master.rights.statements import TrustState
from rossec.master.state.addresses import Endpoint, endpoint, is_loopback_host
from rossec.master.state.doors import MASTER, NODE, Doors, Report
from rossec.master.state.registry import Kind, Registry
from rossec.ros.names import RELAY_DOORS, RELAY_TARGET

_SHOWN: Final = (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)
_UNREACHABLE: Final = (
    "a relay on another host than the master needs doors that others reach: "
    "rossec relay --doors ADDRESS"
)
_ANOTHER: Final = (
    "another relay with this name has come since: end one of them, "
    "or give it a name of its own (rossec relay --name /relay/attic)"
)
_ON_THIS_HOST: Final = (
    "this is registered at a loopback address, and the relay is on another host: "
    "set ROS_IP or ROS_HOSTNAME where it runs"
)


class RelayCalls:
    """Handlers for relays of the own domain; `access_rules` refuses all others.

    Args:
        name, uri: of this master.
        statements: what foreign domains are shown.
    """

    def __init__(
        self, doors: Doors, registry: Registry, statements: TrustState, name: str, uri: str
    ) -> None:
        self._doors = doors
        self._registry = registry
        self._statements = statements
        self._own = name, uri

    def methods(self) -> Methods:
        """The entries of the method table."""
        polled = (text("instance"), number("seen"), arg.doors("doors"), arg.ways("ways"))
        target = (text("domain"), arg.kind("kind"), arg.name("name"))
        return {
            RELAY_DOORS: Method(polled, {}, self._poll),
            RELAY_TARGET: Method(target, [], self._target),
        }

    def _poll(self, request: CallRequest) -> Reply:
        report = _report(request)
        for door in report.doors.values():
            if is_loopback_host(door.host) and not request.is_local:
                raise Refused(_UNREACHABLE)
        if not self._doors.has_room_for(request.caller.name):
            raise Refused("this master has too many relays")
        if self._doors.is_superseded(request.caller.name, report.instance):
            raise Refused(_ANOTHER)
        change = self._doors.hear(request.caller.name, report, request.now)
        answer = {
            "version": change.version,
            "wanted": [list(target) for target in change.wanted],
            "unwanted": [list(target) for target in change.unwanted],
            "masters": dict(self._doors.masters()),
        }
        return Reply(answer, "doors")

    def _target(self, request: CallRequest) -> Reply:
        domain, kind, name = map(request.text, (1, 2, 3))
        place = self._place(kind, name, self._exported(domain, request.now))
        if place is None or place[1] is None:
            raise Refused(f"no {kind} {name} is shown there")
        if is_loopback_host(place[0]) and not request.is_local:
            raise Refused(_ON_THIS_HOST)
        return Reply([*place], "target")

    def _exported(self, label: str, now: int) -> Reach | None:
        """What the domain with this label is shown; None: everything."""
        if not label:
            return None
        domains = self._statements.domains
        listed = domains.anchors.listed(label)
        if listed is None or now >= listed.entry.until:
            raise Refused(f"no domain is called {label[:32]!a} here")
        return domains.exported(listed.entry.domain)

    def _place(self, kind: str, name: str, exported: Reach | None) -> Endpoint | None:
        """Host and port of what is registered here and shown; None: there is no such thing."""
        own_name, own_uri = self._own
        if kind == MASTER:
            return endpoint(own_uri) if name == own_name else None
        if kind == NODE:
            return self._node(name, exported)
        uri, providers = self._registry.service_uri(name), self._registry.registered_nodes
        is_own = any(not is_alias(node.name) for node in providers(Kind.SERVICE, name))
        return endpoint(uri) if uri and is_own and _shows(exported, name) else None

    def _node(self, name: str, exported: Reach | None) -> Endpoint | None:
        node = self._registry.node(name)
        if node is None or is_alias(name):
            return None
        keys = (key for kind in _SHOWN for key in self._registry.keys_of(name, kind))
        shown = _shows(exported, name) or any(_shows(exported, key) for key in keys)
        return endpoint(node.uri) if shown else None


def is_idle(answer: object) -> bool:
    """Whether an answer to a poll tells a relay of nothing, so that it may wait."""
    match answer:
        case [1, str(), {"wanted": [], "unwanted": []}]:
            return True
        case _:
            return False


def _shows(exported: Reach | None, name: str) -> bool:
    return exported is None or exported.covers_any(ALL_RIGHTS, name)


def _report(request: CallRequest) -> Report:
    _, instance, seen, doors, ways = request.arguments
    if not (isinstance(seen, int) and isinstance(doors, dict) and isinstance(ways, dict)):
        raise TypeError("a relay's call whose arguments were not checked")
    return Report(str(instance), seen, doors, ways)
