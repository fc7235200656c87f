"""The effects of a call: updates to nodes, journal records, lines of the audit. A shell.

The cores return events; `deliver` maps each to its effect. Nothing is authorized here and nothing
waits: `Updates` sends updates to nodes, `LongPolls` wakes those that wait. A new revocation list is
enforced before the call that delivered it is answered, except for what would take too long.
"""

import asyncio
import logging
import os
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final, TypeAlias

from ca.bounded import Newest
from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import is_alias, is_in_gateway, shown
from grants.model import Right
from grants.request import is_dispensable, needed_rule, own_form, rule_form
from rossec import files
from rossec.clock import time as host_time
from rossec.master.api import methods
from rossec.master.operation import DENIALS, MasterLimits
from rossec.master.rights import caller, statements
from rossec.master.server.saved_state import DepositFile, ParameterFile
from rossec.master.server.updates import MAX_CLOSING, LongPolls, SlaveDialer, Updates
from rossec.master.state.imported_facts import TypeContradicted
from rossec.master.state.registry import NodeRef, PublishersChanged, ShutdownNode
from rossec.net.aio import SecureContext, SecureStream
from rossec.net.rpc import source_of
from rossec.peer_limits import printable
from rossec.ros.names import DOMAINS_UPDATE, FOREIGN_UPDATE, REVOCATION_UPDATE

LINES_PER_NODE: Final = 200  # lines of one node
MAX_LINES: Final = 10_000  # of all nodes beyond their quotas

# Called with `now`, the node, the right it lacks, and the name
OnDenial: TypeAlias = Callable[[int, str, Right, str], None]


def ignore_denial(now: int, node: str, right: Right, name: str) -> None:
    """In the place of a `DenialLog`: keeps none."""


class DenialLog:
    """The denial log at `path`: one line for every right that a caller lacked, to learn a policy from."""

    # `rossec policy learn --from-log` reads it: callers of services and readers of parameters do not appear
    # in the graph. Each line is written once, and their number is limited: an enrolled node chooses the
    # names, and must not fill the disk with them. Each node has a quota that no other can use up, else one of
    # them could keep the others out of the log.
    def __init__(self, path: Path) -> None:
        from grants.policy.learn import log_line  # noqa: PLC0415 - not loaded without this log

        self._line = log_line
        self._file = os.fdopen(files.append_own(path), "a", encoding="utf-8")
        self._seen: set[tuple[str, Right, str]] = set()
        self._lines_of_node: Counter[str] = Counter()
        self._lines_beyond = 0

    def __call__(self, now: int, node: str, right: Right, name: str) -> None:
        denial = node, right, own_form(node, name)  # one run of an anonymous node is as the next
        is_beyond = self._lines_of_node[node] >= LINES_PER_NODE
        if denial in self._seen or (is_beyond and self._lines_beyond >= MAX_LINES):
            return
        self._seen.add(denial)
        self._lines_of_node[node] += 1
        self._lines_beyond += is_beyond
        self._file.write(self._line(now, node, right, name) + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()


LOGGED_FOR: Final = 3600  # seconds
MAX_CAUSES: Final = 4096
BASICS: Final = "do all that every ROS program asks for and works without, as "
_NO_GRANT: Final = "no grant "

_Cause = tuple[str, Right | None, str]


@dataclass
class _Logged:
    at: int
    left_out: int = 0


class DenialCauses:
    """Refusals for the log and the audit: one line for each cause, in the words of `rossec explain`."""

    # A cause is a right that a node lacks on a name; names of one run of an anonymous node are the same cause
    # as those of the next. It is logged once an hour, with the number of refusals left out. What every ROS
    # program asks for by itself and works without is one cause for each node. Refusals for other reasons,
    # such as an address of another node, are all logged.
    def __init__(self) -> None:
        self._logged: Newest[_Cause, _Logged] = Newest(MAX_CAUSES)

    def text(self, now: int, denied: methods.CallDenied) -> str | None:
        # Of what every program works without it begins with `BASICS`: it is no warning.
        if denied.missing is None:
            return f"{denied.method}: {denied.status}"
        right, name = denied.missing
        own = own_form(denied.certified, name, wildcard=denied.wildcard)
        reason = denied.status.partition(f" on {shown(name)}: ")[2]
        if is_dispensable(right, own) and reason.startswith(_NO_GRANT):
            basics = f"{BASICS}{right.label} {own} and so on: basics: true in a policy would change it"
            return self._once(now, (denied.node, None, ""), basics)
        ruled = shown(rule_form(denied.certified, name, wildcard=denied.wildcard))
        words = reason
        if reason.startswith(_NO_GRANT):
            words = f"{needed_rule(denied.node, [(right, ruled)])} would change it"
        cause = (denied.node, right, own + reason[:80])
        return self._once(now, cause, f"{right.label} {ruled} ({denied.method}): {words}")

    def _once(self, now: int, cause: _Cause, text: str) -> str | None:
        before = self._logged.get(cause)
        if before is not None and 0 <= now - before.at < LOGGED_FOR:
            before.left_out += 1
            return None
        self._logged[cause] = _Logged(now)
        left_out = before.left_out if before is not None else 0
        return f"{text} ({left_out} more like this since it was logged last)" if left_out else text


_audit = logging.getLogger("rossec.audit")
_denials = logging.getLogger(DENIALS)

_CONTRADICTED: Final = "%s is not imported from site %s: it is of type %s there, of %s here"
STEPS_AT_ONCE: Final = 1024  # enforcement steps before the next call is answered
GRANTS_WAIT: Final = 60.0  # seconds; an answer without grants shows that the master is alive
MAX_WAITING: Final = 64  # calls of one key that wait for grants: the nodes of a wildcard identity


class ConnectedStreams:
    """The streams of admitted peers, also by the group that shares a limit: a key, or a foreign domain."""

    # One that comes is counted beside its own group, not beside all. A renewed identity stays in its group.
    def __init__(self) -> None:
        self._groups: dict[SecureStream[Identity], Hashable] = {}
        self._members: dict[Hashable, dict[SecureStream[Identity], None]] = {}

    def __iter__(self) -> Iterator[SecureStream[Identity]]:
        return iter(tuple(self._groups))

    def add(self, stream: SecureStream[Identity]) -> None:
        group = self._groups[stream] = source_of(stream.peer).group
        self._members.setdefault(group, {})[stream] = None

    def discard(self, stream: SecureStream[Identity]) -> None:
        if stream not in self._groups:
            return
        group = self._groups.pop(stream)
        del self._members[group][stream]
        if not self._members[group]:
            del self._members[group]

    def of_group(self, group: Hashable) -> list[SecureStream[Identity]]:
        return list(self._members.get(group, ()))


@dataclass(kw_only=True)
class MasterState(methods.MasterTables):
    """The state of one master, used in its event loop only."""

    clock: Callable[[], float] = host_time
    limits: MasterLimits = field(default_factory=MasterLimits)
    on_denial: OnDenial = ignore_denial
    parameter_file: ParameterFile | None = None  # None: parameters do not survive a restart
    deposit_file: DepositFile | None = None  # None: no deposit is accepted
    streams: ConnectedStreams = field(default_factory=ConnectedStreams)
    graph_changes: LongPolls = field(default_factory=LongPolls)
    grant_changes: LongPolls = field(default_factory=partial(LongPolls, 0.0, MAX_WAITING))
    site_polls: LongPolls = field(default_factory=partial(LongPolls, limit=1))  # followers
    relay_polls: LongPolls = field(default_factory=partial(LongPolls, 0.0, 1))
    # demand_changes, renewal_changes: what local nodes want of other masters, of the authority
    demand_changes: LongPolls = field(default_factory=LongPolls)
    renewal_changes: LongPolls = field(default_factory=LongPolls)
    settled: LongPolls = field(default_factory=partial(LongPolls, 0.0))  # the sites have answered

    def __post_init__(self) -> None:
        if self.parameter_file is not None:
            self.parameters = self.parameter_file.parameters
        if self.deposit_file is not None:
            self.deposits = self.deposit_file.deposits
        super().__post_init__()
        self.parameter_bytes = self.limits.parameters
        self.grants_wait = min(GRANTS_WAIT, self.limits.idle_seconds / 2)
        self.imports.filter.rules = self.trust.domains.imported
        self.imports.on_settled = self.settled.notify
        self.trust.domains.own_sites = self.imports.own_sites
        self.forwarded_ports.on_wanted = self.relay_polls.notify
        self.trust.identities.on_asked = self.renewal_changes.notify

    def now(self) -> int:
        return int(self.clock())

    def notify(self) -> None:
        """Let those know that wait for what has changed since the last call."""
        self.graph_changes.notify(self.registry.version + self.imports.version)
        self.site_polls.notify(self.registry.version)
        self.demand_changes.notify(self.imports.demand.version)

    def notify_all(self) -> None:
        self.graph_changes.notify()
        self.site_polls.notify()


class Effects:
    """Delivers events; `calls` and `denials` are counters."""

    def __init__(self, state: MasterState, context: SecureContext[Identity]) -> None:
        self._state = state
        self._denial_causes = DenialCauses()
        self.dialer: Final = SlaveDialer(context, self.evict)
        most = state.limits.nodes_per_identity + MAX_CLOSING
        self.updates: Final = Updates(self.dialer.dial, most, on_taken=self._record_taken)
        self.stopping: Final = asyncio.Event()
        self.list_changed: Final = asyncio.Event()  # the next round of maintenance must not wait
        self.on_served: Callable[[str], object] = lambda _topic: None  # its publishers have changed
        self.on_new_lists: Final[list[Callable[[], None]]] = []  # one is in force, whoever delivered it
        self.calls = self.denials = 0

    def apply(self, outcome: methods.CallOutcome) -> object:
        self.calls += 1
        for event in outcome.events:
            self.deliver(event)
        self._state.notify()
        return outcome.answer

    def evict(self, node: NodeRef, found: caller.CertifiedPeer) -> None:
        # Remove a node that registered the address of another node, `found`. Otherwise a node could keep
        # another out by registering its address first.
        self.updates.drop(node)
        if self._state.registry.is_current(node):
            gone, other = shown(node.name), shown(found.name)
            _denials.warning("%s is removed: %s answers at %s", gone, other, node.uri)
            for event in self._state.registry.remove_node(node.name):
                self.deliver(event)
            self._state.notify()

    def deliver(self, event: methods.MasterEvent) -> None:  # noqa: C901, PLR0912 - one case for each event
        state, now = self._state, self._state.now
        match event:
            # 1. Updates to nodes.
            case PublishersChanged():
                if is_in_gateway(event.topic):
                    self.on_served(event.topic)
                self.send_publishers(state.aliases.updates(event, now()))
            case methods.ParameterChanged(node, key, value):
                self._notify(node, "paramUpdate", key, value)
            case ShutdownNode(node, reason):
                self._notify(node, "shutdown", f"[{node.name}] Reason: {reason}")
            # 2. What the authority has signed.
            case methods.RevocationsChanged(by):
                _audit.info("%s delivered revocation list %d", by, state.trust.number)
                self._enforce_list()
                self._tell_new_list()
            case methods.DomainsChanged(by):
                _audit.info("%s delivered list of domains %d", by, state.trust.domains.number)
                self._enforce_list()
                for changed in state.imports.taken_anew():
                    self.deliver(changed)
                data = state.trust.domains.anchors.data
                for node in self._own_nodes(now()):
                    self.updates.post(node, (DOMAINS_UPDATE, ""), state.name, data)
                self._tell_new_list()
            case methods.GrantsDeposited(by, holders, count):
                _audit.info("%s deposited %d grants for %d keys", by, count, len(holders))
                state.grant_changes.wake(holders)
            case methods.CallerPresentedGrants(name, refused):
                state.notify_all()  # it may see more or less now
                self.send_publishers(state.aliases.changes_for(name, now()))
                if refused:
                    why = printable("; ".join(refused))
                    _denials.warning("%s presented grants that are refused: %s", name, why)
            # 3. What is written down.
            case methods.PersistParameter(change):
                if state.parameter_file is not None:
                    state.parameter_file.write(change)
            case methods.CallDenied(node):
                self.denials += 1
                if text := self._denial_causes.text(now(), event):
                    level = logging.INFO if text.startswith(BASICS) else logging.WARNING
                    _denials.log(level, "%s may not %s", node, printable(text))
            case methods.Denied(node, right, name):
                state.recent_denials.add(now(), node, right, name)
                state.on_denial(now(), node, right, name)
            case TypeContradicted(label, topic, here, there):
                _audit.warning(_CONTRADICTED, topic, label, there, here)
            case methods.Administered(by, what):
                _audit.info("%s %s", by, printable(what))
            case methods.StopMaster(reason):
                _audit.warning("stopping: %s", printable(reason))
                self.stopping.set()

    def send_publishers(self, updates: Iterable[PublishersChanged]) -> None:
        for topic, nodes, uris in ((u.topic, u.subscribers, u.publisher_uris) for u in updates):
            for node in nodes:
                self._notify(node, "publisherUpdate", topic, list(uris))

    def _tell_new_list(self) -> None:
        for tell in self.on_new_lists:
            tell()
        self._state.notify_all()

    def _notify(self, node: NodeRef, method: str, subject: object, *rest: object) -> None:
        about = subject if isinstance(subject, str) and rest else ""
        self.updates.post(node, (method, about), self._state.name, subject, *rest)

    def _enforce_list(self) -> None:
        self._cut_revoked()  # first: what is registered is checked against every right, and takes longer
        for _ in islice(self.enforcement(), STEPS_AT_ONCE):
            pass
        self.close_revoked()  # also their pending updates
        self.drop_deposits()
        self.send_revocations()
        self._state.relay_polls.notify()  # relays are told by no update: they ask after an answer
        self.list_changed.set()

    def enforcement(self) -> Iterator[None]:
        for step in statements.enforcement_steps(self._state.registry):
            for event in statements.enforce(self._state.registry, self._state.trust, step, self._state.now()):
                self.deliver(event)
            yield

    def close_revoked(self) -> None:
        self._cut_revoked()
        now = self._state.now()
        for node in self.updates.nodes:
            if self._state.trust.caller_of(node, now) is None:
                self.updates.drop(node)

    def _cut_revoked(self) -> None:
        # All of them before a line about one: lines of the audit take longer than the cuts. Whom the list
        # names first: the grants of all others are evaluated anew.
        now, revoked, entries = self._state.now(), [], self._state.trust.revoked()
        with ExitStack() as aborts:  # also of those already found, whatever is raised for a later one
            for stream in sorted(self._state.streams, key=lambda each: entries.isdisjoint(each.peer.keys)):
                try:
                    self._state.trust.caller(stream.peer, now)
                except HintedError as error:
                    aborts.callback(stream.abort, str(error))
                    stream.disconnect()
                    self._state.streams.discard(stream)  # its handler ends in a later iteration
                    revoked.append((stream, str(error)))
        for stream, reason in revoked:
            _audit.warning("%s is disconnected: %s", shown(stream.peer.name), printable(reason))

    def _record_taken(self, node: NodeRef, method: str, params: tuple[object, ...]) -> None:
        match params:
            case (_, bytes(revocations), _) if revocations and method == REVOCATION_UPDATE:
                self._state.trust.record_taken(node, revocations, self._state.now())

    def drop_deposits(self) -> None:
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

    def take_foreign(self, domain: str, revocations: bytes, timestamp: bytes, chain: Sequence[bytes]) -> None:
        """Take what a foreign domain's master says; a newer list is enforced and sent at once."""
        domains = self._state.trust.domains
        before = domains.generation
        try:
            domains.take(domain, revocations, timestamp, chain, self._state.now())
        finally:
            if domains.generation != before:
                # What is newly revoked there is enforced, and its list sent to every node.
                self._enforce_list()
                word, key = domains.word(domain), (FOREIGN_UPDATE, domain)
                params = (domain, word.revocations, word.timestamp, list(word.chain))
                for node in self._own_nodes(self._state.now()) if word.revocations else ():
                    self.updates.post(node, key, self._state.name, *params)

    def _own_nodes(self, now: int) -> list[NodeRef]:
        trust, nodes = self._state.trust, self._state.registry.nodes()
        own = [node for node in nodes if not is_alias(node.name)]
        return [node for node in own if trust.caller_of(node, now) is not None]
