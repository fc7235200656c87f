"""Removing registrations that no valid grant covers any more. Pure.

A grant may be revoked, expire, or belong to a revoked key; each registration is checked against the
rights its node has *now*, so none of these cases needs state of its own. A parameter subscription
is removed when nothing at or below its key is readable; each update is authorized again anyway.
"""

from typing import Final, NamedTuple

from grants.model import Right
from rossec.master.rights.caller import Caller
from rossec.master.rights.served_rights import may_subscribe
from rossec.master.rights.statements import TrustState
from rossec.master.state.registry import Event, Kind, NodeRef, Registry

_REQUIRED_RIGHTS: Final = {
    Kind.PUBLISHER: Right.PUBLISH,
    Kind.SERVICE: Right.PROVIDE,
}
BATCH: Final = 64  # registrations checked in one step, which the loop waits for


class EnforcementStep(NamedTuple):
    """Some registrations of one node."""

    node: NodeRef
    kind: Kind
    keys: tuple[str, ...]


def steps(registry: Registry) -> list[EnforcementStep]:
    """All registrations, in steps; calls may be answered between two."""
    return [
        EnforcementStep(node, kind, keys[begin : begin + BATCH])
        for node in registry.nodes()
        for kind in Kind
        for keys in (registry.keys_of(node.name, kind),)
        for begin in range(0, len(keys), BATCH)
    ]


def enforce(
    registry: Registry,
    trust: TrustState,
    step: EnforcementStep,
    now: int,
) -> list[Event]:
    """Remove the registrations of `step` that no right covers; returns the events to deliver."""
    if not registry.is_current(step.node):
        return []
    caller = trust.caller_of(step.node, now)
    if caller is None:
        return [*registry.remove_node(step.node.name)]
    uncovered = [key for key in step.keys if not _is_authorized(caller, step.kind, key)]
    return [event for key in uncovered for event in registry.remove(step.kind, key, caller.name)]


def _is_authorized(caller: Caller, kind: Kind, key: str) -> bool:
    if kind is Kind.PARAMETER:
        return caller.may_some_below(Right.PARAM_GET, key.removesuffix("/") or "/")
    if kind is Kind.SUBSCRIBER:
        return may_subscribe(caller, key)
    return caller.may(_REQUIRED_RIGHTS[kind], key)
