"""The effects of a call: updates to nodes, journal records, lines of the audit. A shell.

The cores return events; `deliver` maps each to its effect. Nothing is authorized here and nothing
waits: `Updates` sends updates to nodes, `GraphChanges` notifies watchers. A new revocation list is
enforced before the call that delivered it is answered, except for what would take too long.
"""

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import is_alias, shown
from ca.domains.served import is_in_gateway
from ca.errors import HintedError
from ca.revocation.state import digest
from rossec.master.api.methods import (
    Administered,
    CallDenied,
    Denied,
    DomainsChanged,
    GrantsDeposited,
    GrantsPresented,
    MasterEvent,
    ParameterChanged,
    PersistParameter,
    RevocationsChanged,
    StopMaster,
)
from rossec.master.api.turns import CallOutcome
from rossec.master.operation.denial_causes import BASICS, DenialCauses
from rossec.master.operation.denial_limit import DENIALS
from rossec.master.operation.denial_log import OnDenial
from rossec.master.rights.alias_publishers import AliasPublishers
from rossec.master.rights.caller import Peer
from rossec.master.rights.enforce import enforce, steps
from rossec.master.rights.recent_denials import RecentDenials
from rossec.master.rights.statements import TrustState
from rossec.master.server.deposit_file import DepositFile
from rossec.master.server.dialer import SlaveDialer
from rossec.master.server.grant_changes import GrantChanges
from rossec.master.server.graph_changes import GraphChanges
from rossec.master.server.parameter_file import ParameterFile
from rossec.master.server.site_polls import SitePolls
from rossec.master.server.updates import Updates
from rossec.master.state.doors import Doors
from rossec.master.state.graph import Graph
from rossec.master.state.import_events import TypeContradicted
from rossec.master.state.imports import Imports
from rossec.master.state.registry import NodeRef, PublishersChanged, Registry, ShutdownNode
from rossec.net.aio import SecureContext, SecureStream
from rossec.ros.names import DOMAINS_UPDATE, FOREIGN_UPDATE, REVOCATION_UPDATE
from rossec.ros.text import printable

_audit = logging.getLogger("rossec.audit")
_denials = logging.getLogger(DENIALS)

_CONTRADICTED: Final = "%s is not imported from site %s: it is of type %s there, of %s here"
STEPS_AT_ONCE: Final = 1024  # enforcement steps before the next call is answered
_Recorded = PersistParameter | Denied | GrantsPresented | CallDenied | TypeContradicted


@dataclass
class MasterState:
    """The state of one master, used in its event loop only.

    Args:
        name: the master's certified name.
        clock: seconds since the epoch.
        parameter_file: the journal of parameters; None: they do not survive a restart.
        deposit_file: the journal of deposited grants; None: none is accepted.
        streams: accepted connections.
        imports: what other masters have registered.
        site_polls: followers that wait for changes of the registrations.
        demand_changes, renewal_changes: what local nodes want of other masters, of the authority.
        doors: of the own relays.
        relay_polls: relays that wait for what is wanted.
    """

    name: str
    clock: Callable[[], float]
    registry: Registry
    trust: TrustState
    parameter_file: ParameterFile | None
    deposit_file: DepositFile | None = None
    graph_changes: GraphChanges = field(default_factory=GraphChanges)
    grant_changes: GrantChanges = field(default_factory=GrantChanges)
    streams: set[SecureStream[Identity]] = field(default_factory=set)
    recent_denials: RecentDenials = field(default_factory=RecentDenials)
    site_polls: SitePolls = field(default_factory=SitePolls)
    demand_changes: GraphChanges = field(default_factory=GraphChanges)
    renewal_changes: GraphChanges = field(default_factory=GraphChanges)
    doors: Doors = field(default_factory=Doors)
    relay_polls: SitePolls = field(default_factory=partial(SitePolls, 0.0))
    imports: Imports = field(init=False)
    aliases: AliasPublishers = field(init=False)

    def __post_init__(self) -> None:
        self.imports = Imports(self.registry)
        self.aliases = AliasPublishers(Graph(self.registry, self.imports), self.trust.caller_of)
        self.imports.intake.rules = self.trust.domains.imported
        self.doors.on_wanted = self.relay_polls.notify
        self.trust.identities.on_asked = self.renewal_changes.notify

    def now(self) -> int:
        """The time, in whole seconds."""
        return int(self.clock())

    def notify(self) -> None:
        """Let those know that wait for what has changed since the last call."""
        self.graph_changes.notify(self.registry.version + self.imports.version)
        self.site_polls.notify(self.registry.version)
        self.demand_changes.notify(self.imports.demand.version)

    def notify_all(self) -> None:
        """Rights or lists have changed: every answer may be another one."""
        self.graph_changes.notify()
        self.site_polls.notify()


class Effects:
    """Delivers events; `calls` and `denials` are counters.

    Args:
        context: the master's own identity, to connect to nodes with.
        on_denial: called for every right that a caller lacks.
        max_clients: as of `Updates`.

    Attributes:
        stopping: set by `StopMaster`.
        on_new_lists: called when a newer list is in force, whoever delivered it.
        list_changed: set by `RevocationsChanged`: the next round of maintenance must not wait.
        on_served: called with a served name whose publishers have changed.
    """

    def __init__(
        self,
        state: MasterState,
        context: SecureContext[Identity],
        on_denial: OnDenial,
        max_clients: int,
    ) -> None:
        self._state = state
        self._on_denial, self._denial_causes = on_denial, DenialCauses()
        self.dialer: Final = SlaveDialer(context, self.evict)
        self.updates: Final = Updates(self.dialer.dial, max_clients, on_taken=self._record_taken)
        self.stopping: Final = asyncio.Event()
        self.list_changed: Final = asyncio.Event()
        self.on_served: Callable[[str], None] = _ignore
        self.on_new_lists: Final[list[Callable[[], None]]] = []
        self.calls = self.denials = 0

    def apply(self, outcome: CallOutcome) -> object:
        """Deliver the events of a call; returns the answer."""
        self.calls += 1
        for event in outcome.events:
            self.deliver(event)
        self._state.notify()
        return outcome.answer

    def evict(self, node: NodeRef, found: Peer) -> None:
        """Remove a node that registered the address of another node, `found`.

        Otherwise a node could keep another out by registering its address first.
        """
        self.updates.drop(node)
        if self._state.registry.is_current(node):
            gone, other = shown(node.name), shown(found.name)
            _denials.warning("%s is removed: %s answers at %s", gone, other, node.uri)
            for event in self._state.registry.remove_node(node.name):
                self.deliver(event)
            self._state.notify()

    def deliver(self, event: MasterEvent) -> None:
        """Perform the effect of `event`."""
        match event:
            case PublishersChanged():
                self._publishers_changed(event)
            case ParameterChanged(node, key, value):
                self._notify(node, "paramUpdate", key, value)
            case ShutdownNode(node, reason):
                self._notify(node, "shutdown", f"[{node.name}] Reason: {reason}")
            case RevocationsChanged() | DomainsChanged():
                self._list_changed(event)
                self._state.notify_all()
            case GrantsDeposited(by, holders, count):
                _audit.info("%s deposited %d grants for %d keys", by, count, len(holders))
                self._state.grant_changes.notify(holders)
            case Administered(by, what):
                _audit.info("%s %s", by, printable(what))
            case (
                PersistParameter()
                | Denied()
                | GrantsPresented()
                | CallDenied()
                | TypeContradicted()
            ):
                self._record(event)
            case StopMaster(reason):
                _audit.warning("stopping: %s", printable(reason))
                self.stopping.set()

    def _publishers_changed(self, event: PublishersChanged) -> None:
        if is_in_gateway(event.topic):
            self.on_served(event.topic)
        self.send_publishers(self._state.aliases.updates(event, self._state.now()))

    def send_publishers(self, updates: Iterable[PublishersChanged]) -> None:
        """Send subscribers their lists of publishers."""
        for topic, nodes, uris in ((u.topic, u.subscribers, u.publisher_uris) for u in updates):
            for node in nodes:
                self._notify(node, "publisherUpdate", topic, list(uris))

    def _list_changed(self, event: RevocationsChanged | DomainsChanged) -> None:
        trust = self._state.trust
        match event:
            case RevocationsChanged(by):
                _audit.info("%s delivered revocation list %d", by, trust.number)
                self._enforce_list()
            case DomainsChanged(by):
                _audit.info("%s delivered list of domains %d", by, trust.domains.number)
                self._enforce_list()
                for changed in self._state.imports.taken_anew():
                    self.deliver(changed)
                self.send_domains()
        for tell in self.on_new_lists:
            tell()

    def _record(self, event: _Recorded) -> None:
        match event:
            case TypeContradicted(label, topic, here, there):
                _audit.warning(_CONTRADICTED, topic, label, there, here)
            case PersistParameter(change):
                if self._state.parameter_file is not None:
                    self._state.parameter_file.write(change)
            case CallDenied(node):
                self.denials += 1
                if text := self._denial_causes.text(self._state.now(), event):
                    level = logging.INFO if text.startswith(BASICS) else logging.WARNING
                    _denials.log(level, "%s may not %s", node, printable(text))
            case Denied(node, right, name):
                self._state.recent_denials.add(self._state.now(), node, right, name)
                self._on_denial(self._state.now(), node, right, name)
            case GrantsPresented(name, refused):
                self._state.notify_all()  # it may see more or less now
                self.send_publishers(self._state.aliases.changes_for(name, self._state.now()))
                if refused:
                    text = printable("; ".join(refused))
                    _denials.warning("%s presented grants that are refused: %s", name, text)

    def _notify(self, node: NodeRef, method: str, subject: object, *rest: object) -> None:
        about = subject if isinstance(subject, str) and rest else ""
        self.updates.post(node, (method, about), self._state.name, subject, *rest)

    def _enforce_list(self) -> None:
        """Enforce a new list: as much as possible now, the rest in the next round."""
        for _ in islice(self.enforcement(), STEPS_AT_ONCE):
            pass
        self.close_revoked()  # also their pending updates
        self.drop_deposits()
        self.send_revocations()
        self._state.relay_polls.notify()  # relays are told by no update: they ask after an answer
        self.list_changed.set()

    def enforcement(self) -> Iterator[None]:
        """Remove what is no longer authorized, some registrations in each step."""
        for step in steps(self._state.registry):
            for event in enforce(self._state.registry, self._state.trust, step, self._state.now()):
                self.deliver(event)
            yield

    def close_revoked(self) -> None:
        """Close the connections of revoked identities, and drop their updates."""
        now = self._state.now()
        for stream in tuple(self._state.streams):
            try:
                self._state.trust.caller(stream.peer, now)
            except HintedError as error:
                name = shown(stream.peer.name)
                _audit.warning("%s is disconnected: %s", name, printable(error))
                self._state.streams.discard(stream)  # its handler ends in a later iteration
                stream.abort(str(error))
        for node in self.updates.nodes:
            if self._state.trust.caller_of(node, now) is None:
                self.updates.drop(node)

    def _record_taken(self, node: NodeRef, method: str, params: tuple[object, ...]) -> None:
        """A node that has taken a list has closed what the list ends."""
        match params:
            case (_, bytes(revocations), _) if revocations and method == REVOCATION_UPDATE:
                taken = digest(revocations)
                self._state.trust.held_lists.record(node, taken, self._state.now())

    def drop_deposits(self) -> None:
        """Remove the deposited grants that have ended or are revoked."""
        file = self._state.deposit_file
        if file is not None:
            file.deposits.drop_ended(self._state.now(), self._state.trust.revoked())

    def send_revocations(self) -> None:
        """Send every node a timestamp of the list, and the list to nodes that do not hold it."""
        now, key = self._state.now(), (REVOCATION_UPDATE, "")
        for node in self._own_nodes(now):
            revocations, timestamp = self._state.trust.revocations_for(node, now)
            if timestamp:
                self.updates.post(node, key, self._state.name, revocations, timestamp)

    def send_domains(self) -> None:
        """Send every node of the own domain the list of domains."""
        data = self._state.trust.domains.anchors.data
        for node in self._own_nodes(self._state.now()):
            self.updates.post(node, (DOMAINS_UPDATE, ""), self._state.name, data)

    def take_foreign(
        self, domain: str, revocations: bytes, timestamp: bytes, chain: Sequence[bytes]
    ) -> None:
        """Take what a foreign domain's master says; a newer list is enforced and sent at once.

        Raises:
            CAError: as `Standing.take_foreign`; a valid list counts even if its timestamp does not.
        """
        domains = self._state.trust.domains
        before = domains.generation
        try:
            domains.take(domain, revocations, timestamp, chain, self._state.now())
        finally:
            if domains.generation != before:
                self.foreign_revocations_changed(domain)

    def foreign_revocations_changed(self, domain: str) -> None:
        """Enforce what is newly revoked in a foreign domain, and send its list to every node."""
        self._enforce_list()
        word, key = self._state.trust.domains.word(domain), (FOREIGN_UPDATE, domain)
        params = (domain, word.revocations, word.timestamp, list(word.chain))
        for node in self._own_nodes(self._state.now()) if word.revocations else ():
            self.updates.post(node, key, self._state.name, *params)

    def _own_nodes(self, now: int) -> list[NodeRef]:
        """The registered nodes of the own domain; foreigners hear from their own master."""
        trust, nodes = self._state.trust, self._state.registry.nodes()
        own = [node for node in nodes if not is_alias(node.name)]
        return [node for node in own if trust.caller_of(node, now) is not None]


def _ignore(_topic: str) -> None:
    pass
