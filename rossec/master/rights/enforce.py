"""What must go when rights end: registrations no valid grant covers any more. Pure.

A grant may be revoked, expire, or belong to a revoked key; the registry is compared with what the
nodes may do *now*, so none of these needs bookkeeping of its own. A parameter subscription goes
when nothing that may be below it can be read; each update asks for the right again anyway.
"""

from typing import Final, NamedTuple

from grants.model import Right
from rossec.master.rights.access_rules import Caller
from rossec.master.rights.interfaces import Statements
from rossec.master.state.registry import Event, Kind, NodeRef, Registry

_NEEDED: Final = {
    Kind.PUBLISHER: Right.PUBLISH,
    Kind.SUBSCRIBER: Right.SUBSCRIBE,
    Kind.SERVICE: Right.PROVIDE,
}


BATCH: Final = 64  # registrations judged in one step: what the loop waits for


class EnforcementStep(NamedTuple):
    """Some registrations of one node."""

    node: NodeRef
    kind: Kind
    keys: tuple[str, ...]


def steps(registry: Registry) -> list[EnforcementStep]:
    """The work of judging all registrations, in pieces; calls may be answered between two."""
    return [
        EnforcementStep(node, kind, keys[begin : begin + BATCH])
        for node in registry.nodes()
        for kind in Kind
        for keys in (registry.keys_of(node.name, kind),)
        for begin in range(0, len(keys), BATCH)
    ]


def enforce(
    registry: Registry,
    statements: Statements,
    step: EnforcementStep,
    now: int,
) -> list[Event]:
    """Remove the registrations of `step` that have no right any more, and say whom to tell."""
    if not registry.is_current(step.node):
        return []
    caller = statements.caller_of(step.node, now)
    if caller is None:
        return [*registry.remove_node(step.node.name)]
    lost = [key for key in step.keys if not _may_stay(caller, step.kind, key)]
    return [event for key in lost for event in registry.remove(step.kind, key, caller.name)]


def _may_stay(caller: Caller, kind: Kind, key: str) -> bool:
    if kind is Kind.PARAMETER:
        return caller.may_some_below(Right.PARAM_GET, key.removesuffix("/") or "/")
    return caller.may(_NEEDED[kind], key)
