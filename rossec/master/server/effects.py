"""The effects of a call: updates to nodes, journal records, lines of the audit. A shell.

The cores return events; `deliver` maps each to its effect. Nothing is authorized here and nothing
waits: `Updates` sends updates to nodes, `GraphChanges` notifies watchers. A revocation has further
effects: `rossec.master.server.maintenance`.
"""

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from ca.certificates import Identity
from rossec.master.api.methods import (
    Administered,
    CallDenied,
    Denied,
    GrantsPresented,
    MasterEvent,
    ParameterChanged,
    PersistParameter,
    RevocationsChanged,
    StopMaster,
)
from rossec.master.api.turns import CallOutcome
from rossec.master.operation.denial_limit import DENIALS
from rossec.master.operation.denial_log import OnDenial
from rossec.master.rights.access_rules import Peer
from rossec.master.rights.statements import TrustState
from rossec.master.server.graph_changes import GraphChanges
from rossec.master.server.parameter_file import ParameterFile
from rossec.master.server.updates import Updates
from rossec.master.state.registry import NodeRef, PublishersChanged, Registry, ShutdownNode
from rossec.net.aio import SecureStream
from rossec.ros.text import printable

_audit = logging.getLogger("rossec.audit")
_denials = logging.getLogger(DENIALS)


@dataclass(frozen=True)
class MasterState:
    """The state of one master, used in its event loop only.

    Args:
        name: the master's certified name.
        now: seconds since the epoch.
        parameter_file: the journal of parameters; None: they do not survive a restart.
        streams: accepted connections.
    """

    name: str
    now: Callable[[], int]
    registry: Registry
    trust: TrustState
    updates: Updates
    parameter_file: ParameterFile | None
    graph_changes: GraphChanges = field(default_factory=GraphChanges)
    streams: set[SecureStream[Identity]] = field(default_factory=set)


class Effects:
    """Delivers events; `calls` and `denials` are counters, `StopMaster` sets `stopping`.

    Args:
        on_denial: called for every right that a caller lacks.
        on_revocations: called when there is a newer revocation list.
    """

    def __init__(
        self, state: MasterState, on_denial: OnDenial, on_revocations: Callable[[], None]
    ) -> None:
        self._state = state
        self._on_denial = on_denial
        self._on_revocations = on_revocations
        self.stopping: Final = asyncio.Event()
        self.calls = self.denials = 0

    def apply(self, outcome: CallOutcome) -> object:
        """Deliver the events of a call; returns the answer."""
        self.calls += 1
        for event in outcome.events:
            self.deliver(event)
        self._state.graph_changes.notify(self._state.registry.version)
        return outcome.answer

    def evict(self, node: NodeRef, found: Peer) -> None:
        """Remove a node that registered the address of another node, `found`.

        Otherwise a node could keep another out by registering its address first.
        """
        self._state.updates.drop(node)
        if self._state.registry.is_current(node):
            _denials.warning("%s is removed: %s answers at %s", node.name, found.name, node.uri)
            for event in self._state.registry.remove_node(node.name):
                self.deliver(event)
            self._state.graph_changes.notify(self._state.registry.version)

    def deliver(self, event: MasterEvent) -> None:
        """Perform the effect of `event`."""
        match event:
            case PublishersChanged(topic, subscribers, uris):
                for node in subscribers:
                    self._notify(node, "publisherUpdate", topic, list(uris))
            case ParameterChanged(node, key, value):
                self._notify(node, "paramUpdate", key, value)
            case ShutdownNode(node, reason):
                self._notify(node, "shutdown", f"[{node.name}] Reason: {reason}")
            case RevocationsChanged(by):
                _audit.info("%s delivered revocation list %d", by, self._state.trust.number)
                self._on_revocations()
            case Administered(by, what):
                _audit.info("%s %s", by, printable(what))
            case PersistParameter() | Denied() | GrantsPresented() | CallDenied():
                self._record(event)
            case StopMaster(reason):
                _audit.warning("stopping: %s", printable(reason))
                self.stopping.set()

    def _record(self, event: PersistParameter | Denied | GrantsPresented | CallDenied) -> None:
        match event:
            case PersistParameter(change):
                if self._state.parameter_file is not None:
                    self._state.parameter_file.write(change)
            case CallDenied(node, method, status):
                self.denials += 1
                _denials.warning("%s may not %s: %s", node, method, printable(status))
            case Denied(node, right, name):
                self._on_denial(self._state.now(), node, right, name)
            case GrantsPresented(name, refused):
                self._state.graph_changes.notify()  # it may see more or less now
                if refused:
                    text = printable("; ".join(refused))
                    _denials.warning("%s presented grants that are refused: %s", name, text)

    def _notify(self, node: NodeRef, method: str, subject: object, *rest: object) -> None:
        about = subject if isinstance(subject, str) and rest else ""
        self._state.updates.post(node, (method, about), self._state.name, subject, *rest)
