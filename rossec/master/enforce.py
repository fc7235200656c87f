"""What must go when rights end: registrations no valid grant covers any more. Pure.

A grant may be revoked, expire, or belong to a revoked key; the registry is compared with what the
nodes may do *now*, so none of these needs bookkeeping of its own. Parameter subscriptions stay:
each update asks for the right again before it is sent.
"""

from typing import Final

from grants.model import Right
from rossec.master.api import Statements
from rossec.master.calls import MasterEvent
from rossec.master.gatekeeper import Caller
from rossec.master.registry import Kind, Registry

_NEEDED: Final = {
    Kind.PUBLISHER: Right.PUBLISH,
    Kind.SUBSCRIBER: Right.SUBSCRIBE,
    Kind.SERVICE: Right.PROVIDE,
}


def enforce(registry: Registry, statements: Statements, now: int) -> list[MasterEvent]:
    """Remove every registration without a right, and say whom to tell."""
    events: list[MasterEvent] = []
    for node in tuple(registry.nodes()):
        caller = statements.caller_of(node, now)
        if caller is None:
            events += registry.remove_node(node.name)
        else:
            events += _enforce_node(registry, caller)
    return events


def _enforce_node(registry: Registry, caller: Caller) -> list[MasterEvent]:
    events: list[MasterEvent] = []
    for kind, right in _NEEDED.items():
        for key in registry.keys_of(caller.name, kind):
            if not caller.may(right, key):
                events += registry.remove(kind, key, caller.name)
    return events
