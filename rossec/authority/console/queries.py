"""What the console is shown: the record, the policy, and what the master says.

Each answer is one look, newest first where it is long: what does not fit into an answer is left
out, and the log of the service says so. Nothing here needs the key. The master is asked as `/ca`,
through the network process, and only while somebody looks; pages get what was heard last.
"""

import contextlib
import hashlib
import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from ca.approvals.statement import StatementKind
from ca.encoding import Value, encode
from ca.errors import HintedError, RevocationRefused
from ca.revocation.trust_status import open_statement
from ca.store import log, record
from ca.store.values import RevocationRow
from grants import document
from grants.errors import PolicyRefused
from grants.policy.difference import Change, ChangeKind
from grants.policy.source import MAX_SIZE
from rossec import clock, files
from rossec.authority import invitations
from rossec.authority.console import messages
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile
from rossec.authority.session import StatementCall
from rossec.errors import AnswerMalformed, ConfigurationError, NotDelivered
from rossec.participant.registrations import WATCH_GRAPH, GraphView

KEPT: Final = 30 * 86400  # seconds for which ended grants are shown
MAX_EVENTS: Final = 500  # of one answer
MAX_APPROVALS: Final = 100
_MAX_NUMBER: Final = (1 << 63) - 1  # of SQLite
_MAX_ROWS: Final = 20_000  # grants that are looked at
ROOM: Final = messages.MAX_ANSWER - 64 * 1024
_log = logging.getLogger("rossec.authority.service")

Deliveries = Callable[[], Mapping[bytes, str]]


@dataclass(eq=False, repr=False)
class RecordQueries:
    """`last_used`: when passkeys were last used to log in. `deliveries`: what the master says of each
    grant; without one, nothing.
    """

    work: AuthorityWork
    last_used: Callable[[bytes], int]
    deliveries: Deliveries = dict

    def nodes(self) -> Value:
        at = self.work.now()
        with self.work.record() as store, store.database.read_transaction():
            ended = {row.entry: row for row in store.revocations()}
            rows = store.identities.all()
        found: dict[tuple[str, bytes], record.CertificateRow] = {}
        newest = {row.name: row for row in rows}
        for row in rows:
            is_valid = at <= row.not_after and row.thumbprint not in ended
            if is_valid or newest[row.name].thumbprint == row.thumbprint:
                found[row.name, row.thumbprint] = row
        views = []
        for row in found.values():
            key, span, gone = row.thumbprint, (row.not_before, row.not_after), _end(ended.get(row.thumbprint))
            views.append(messages.NodeView(row.name, key, *span, row.wildcard, *gone))
        return bounded("identities", reversed(views), lambda view: view.name)

    def grants(self) -> Value:
        oldest = self.work.now() - KEPT
        with self.work.record() as store, store.database.read_transaction():
            ended = {row.entry: row for row in store.revocations()}
            rules, signed = store.policy_grants(), store.signed_at()
            rows = store.grants()
        states, views = self.deliveries(), []
        for row in shared(reversed(rows), lambda row: row.name, _MAX_ROWS):
            grant = document.peek(row.data)
            revoked = ended.get(row.id) or ended.get(grant.holder)
            if min(grant.cap, revoked.at if revoked else grant.cap) < oldest:
                continue
            at, rule, state = signed[row.id], rules.get(row.id, ""), states.get(row.id, "")
            times = at, grant.expires, grant.cap
            views.append(messages.GrantView(row.id, row.name, row.data, *times, *_end(revoked), rule, state))
        return bounded("grants", views, lambda view: view.node)

    def identity_requests(self) -> Value:
        at = self.work.now()
        with self.work.record() as store:
            store.requests.collect(at)
            views = []
            for row in store.requests.open(at):
                known = store.identities.by_name(row.name)
                about = row.digest, row.name, row.thumbprint, row.source, row.arrived, row.expires
                is_other_key = any(each.thumbprint != row.thumbprint for each in known)
                views.append(
                    messages.IdentityRequestView(*about, str(row.state), row.wildcard, is_other_key, row.der)
                )
        return bounded("requests", reversed(views))

    def invitations(self) -> Value:
        at = self.work.now()
        with self.work.record() as store, store.database.read_transaction():
            found = [(each, each.row, each.state(at)) for each in invitations.invitations(store)]
        views = []
        for each, row, state in found:
            names = tuple(use.name for use in each.uses)
            about = row.id, row.pattern, row.uses, names, row.wildcard, row.expires, row.at
            views.append(messages.InvitationView(*about, state))
        return bounded("join codes", reversed(views))

    def phones(self) -> Value:
        with self.work.record() as store, store.database.read_transaction():
            known, ended = store.passkeys.all(), store.passkeys.ended()
            used, by = store.approvals.last_used(), store.approvals.approvers(StatementKind.PASSKEY)
        names = {each.id: each.name for each in known}
        views = []
        for each in known:
            last = max(used.get(each.id, 0), self.last_used(each.id))
            by_whom, why = names.get(by.get(each.approval, b""), ""), ended.get(each.id)
            end = "" if why is None else why or "removed"
            views.append(messages.PhoneView(each.id, each.name, each.at, last, by_whom, end))
        return bounded("phones", views)

    def approvals(self, count: int) -> Value:
        with self.work.record() as store, store.database.read_transaction():
            found = store.approvals.newest(max(0, min(count, MAX_APPROVALS)))
            ends = store.approvals.ends()
            names = {each.id: each.name for each in store.passkeys.all()}
        views = []
        for each in found:
            end = ends.get(each.id)
            try:
                said = messages.sentence(each.read(), each.payload)
            except HintedError as error:
                said = f"an approval that cannot be read: {error}"
            phone = names.get(each.passkey, "")
            state, result = (end.state, end.result) if end else (str(log.ApprovalState.WAITING), "")
            views.append(messages.ApprovalView(each.id, each.kind, said, phone, each.at, state, result))
        return bounded("approvals", views)

    def events(self, before: int, count: int) -> Value:
        with self.work.record() as store:
            last = min(before, _MAX_NUMBER) if before > 0 else None
            found = store.log.newest(max(0, min(count, MAX_EVENTS)), last)
        return bounded("entries", [messages.EventView(*each[:5]) for each in found])


V = TypeVar("V", bound=tuple[Any, ...])
T = TypeVar("T")


def bounded(what: str, views: Iterable[V], owner: Callable[[V], str] = lambda _: "") -> list[Value]:
    given = list(views)
    room = ROOM
    values: dict[int, Value] = {}
    for place in _in_turns([owner(view) for view in given]):
        value = messages.to_value(given[place])
        room -= len(encode(value))
        if room < 0:
            _log.warning("the console is shown the newest %d %s only", len(values), what)
            break
        values[place] = value
    return [values[place] for place in sorted(values)]


def shared(items: Iterable[T], owner: Callable[[T], str], limit: int) -> list[T]:
    given = list(items)
    chosen = _in_turns([owner(item) for item in given])[:limit]
    return [given[place] for place in sorted(chosen)]


def _in_turns(owners: Sequence[str]) -> list[int]:
    # The places in turns: the first of each owner, then the second of each, and so on.
    count = Counter[str]()
    turns: list[tuple[int, int]] = []
    for place, owner in enumerate(owners):
        turns.append((count[owner], place))
        count[owner] += 1
    return [place for _, place in sorted(turns)]


def _end(revoked: RevocationRow | None) -> tuple[int, str]:
    return (0, "") if revoked is None else (revoked.at, revoked.reason)


def stamp(path: Path) -> tuple[int, ...]:
    """What differs when the file was changed or replaced; empty: there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


class PolicyNames:
    # For every page, so the policy is read only when its file has changed. While it has mistakes there are
    # no titles.

    def __init__(self, work: AuthorityWork) -> None:
        self._work = work
        self._read: tuple[int, ...] = ()
        self._names: tuple[messages.PolicyName, ...] = ()

    def policy_names(self) -> Value:
        path = self._work.policy_path()
        found = stamp(path)  # before reading: a later change is then seen
        if found != self._read:
            names: tuple[messages.PolicyName, ...] = ()
            if found:
                with contextlib.suppress(HintedError):  # told on the page of the policy
                    policy = PolicyFile.read(path, own=True).policy
                    names = tuple(
                        messages.PolicyName(name, policy.titles.get(name, ""), policy.types.get(name, ""))
                        for name in sorted(policy.titles.keys() | policy.types.keys())
                    )
            self._read, self._names = found, names
        return bounded("names of the policy", self._names)


PURPOSE: Final = "a look at the policy"
MAX_REFUSED: Final = 64


class PolicyQuery:
    def __init__(self, work: AuthorityWork) -> None:
        self._work = work

    def policy(self) -> Value:
        path = self._work.policy_path()
        empty = messages.PolicyView(str(path), b"", (), (), 0, ())
        if not path.exists():
            return messages.to_value(empty)
        read = b""
        try:
            read = files.read(path, MAX_SIZE, ConfigurationError(f"there is no policy in {path}"))
            file = PolicyFile.read(path, own=True)
            read = file.text.encode()
            with self._work.service(PURPOSE) as service:
                plan = service.policy.plan(file)
        except HintedError as error:
            digest = hashlib.sha256(read).digest() if read else b""
            found = error.mistakes if isinstance(error, PolicyRefused) else ()
            mistakes = tuple(map(str, found)) or (str(error),)
            return messages.to_value(empty._replace(digest=digest, mistakes=mistakes))
        changes = [change for node in plan.nodes for change in node.changes]
        kept, gone = ChangeKind.KEPT, ChangeKind.GONE
        return messages.to_value(
            empty._replace(
                digest=hashlib.sha256(read).digest(),
                gives=tuple(_right(each) for each in changes if each.kind not in (kept, gone)),
                takes=tuple(_right(each) for each in changes if each.kind is gone),
                keeps=sum(each.kind is kept for each in changes),
                refused=plan.refused[:MAX_REFUSED],
            )
        )


def _right(change: Change) -> messages.PolicyRight:
    lines: Sequence[str] = change.restrictions
    until = ""
    if change.kind is not ChangeKind.GONE:
        *lines, until = change.restrictions
    words, span = "; ".join(lines), until.removeprefix("valid ")
    return messages.PolicyRight(change.subject.name, int(change.right), change.pattern, words, span)


TRUST_STATUS: Final = "rossec.revocationStatus"
DENIALS: Final = "rossec.recentDenials"
PERIOD: Final = 2.0  # seconds between two questions
FRESH: Final = 30.0  # seconds for which what was heard is shown
SHORT: Final = 3.0  # seconds for an answer that a page waits for
LONG: Final = 15.0  # for one that the master delays until there is news
MAX_FACTS: Final = 20_000
_HINT: Final = "it is asked again"


class MasterView:
    """`deliver`: calls the master. Raises `NotDelivered`. `elapsed`: seconds of a clock that cannot be set.
    `begin`: calls a function in another thread. `came_back`: called when the master answers again:
    something may wait for it.
    """

    def __init__(
        self,
        work: AuthorityWork,
        deliver: Callable[[StatementCall], object],
        elapsed: clock.Seconds | None = None,
        begin: Callable[[Callable[[], None]], None] | None = None,
        came_back: Callable[[], None] = lambda: None,
    ) -> None:
        self._work = work
        self._deliver = deliver
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._begin = begin or _in_thread
        self._came_back = came_back
        self._is_away = False
        self._asking = threading.Lock()  # held by the thread that asks
        self._begun = self._heard = self._trust_status_asked = float("-inf")
        self._view = GraphView()
        self._denials: tuple[messages.DenialView, ...] = ()
        self._trust_status: messages.ListProgress | None = None
        self._changes = 0

    def look(self) -> int:
        if self._elapsed() - self._begun >= PERIOD and self._asking.acquire(blocking=False):
            self._begun = self._elapsed()
            self._begin(self._ask_and_release)
        return self._changes

    def graph(self) -> Value:
        view = self._view
        if self._elapsed() - self._heard > FRESH:
            view = GraphView()
            self._watch(view, SHORT)
        return messages.to_value(tuple(messages.FactView(*fact) for fact in sorted(view.facts)))

    def denials(self) -> Value:
        is_old = self._elapsed() - self._heard > FRESH
        return messages.to_value(self._recent_denials() if is_old else self._denials)

    def trust_status(self, epoch: int, seq: int) -> Value:
        self._trust_status_asked = self._elapsed()
        self._trust_status = self._list_trust_status(epoch, seq)
        return messages.to_value(self._trust_status)

    def _ask_and_release(self) -> None:
        try:
            with contextlib.suppress(ConfigurationError, AnswerMalformed):
                self._ask()
            if self._is_away:
                self._is_away = False
                self._came_back()
        except NotDelivered:  # what was heard is old: whoever looks is told now
            self._changes += not self._is_away
            self._is_away, self._heard = True, float("-inf")
        finally:
            self._asking.release()

    def _ask(self) -> None:
        # Ask what pages are likely to show; a page with ticks is not kept waiting by the graph.
        trust_status = self._trust_status
        if trust_status is not None and self._elapsed() - self._trust_status_asked < FRESH:
            self._note(trust_status, self._list_trust_status(trust_status.epoch, trust_status.seq))
            if self._elapsed() - self._heard < FRESH / 2:
                return
        before = self._view.facts
        self._watch(self._view, LONG)
        self._note(before, self._view.facts)
        self._heard = self._elapsed()
        with contextlib.suppress(NotDelivered):
            known, self._denials = self._denials, self._recent_denials()
            self._note(*({each[1:] for each in some} for some in (known, self._denials)))

    def _note(self, before: object, after: object) -> None:
        self._changes += before != after

    def _watch(self, view: GraphView, within: float) -> None:
        more = True
        while more:
            answer = self._call(WATCH_GRAPH, (*view.next_params,), "a question about the graph", within)
            more = view.take(answer).more
            if len(view.facts) > MAX_FACTS:
                raise NotDelivered(f"the graph has more than {MAX_FACTS} facts", _HINT)

    def _recent_denials(self) -> tuple[messages.DenialView, ...]:
        answer = self._call(DENIALS, (), "a question about denials", SHORT)
        if not isinstance(answer, list):
            raise NotDelivered("the master's answer about denials is malformed", _HINT)
        found = []
        for row in answer:
            match row:
                case [int(ago), str(node), int(right), str(name)]:
                    found.append(messages.DenialView(self._work.now() - ago, node, right, name))
                case _:
                    raise NotDelivered("the master's answer about denials is malformed", _HINT)
        return tuple(found)

    def _list_trust_status(self, epoch: int, seq: int) -> messages.ListProgress:
        home, now = self._work.home(), self._work.now()
        with closing(home.store()) as store:
            data = store.newest_list()
        newest = (0, 0)
        with contextlib.suppress(RevocationRefused):
            if data is not None:
                found = open_statement(data, home.anchor().public_key)
                newest = found.epoch, found.seq
        wanted = (epoch, seq)
        if wanted == (0, 0) and home.count_unlisted(now) == 0:
            wanted = newest
        if wanted == (0, 0) or newest < wanted:
            return messages.ListProgress(epoch, seq, False, False, 0, 0)
        # If the master does not answer, what it took before is said. Nodes that hold a newer list than was
        # asked for hold this one too.
        answer: object = None
        with contextlib.suppress(NotDelivered):
            answer = self._call(TRUST_STATUS, (), "a question about a list", SHORT)
        match answer:
            case {"list": str(number), "nodes": int(nodes), "holding": int(holding)} if 0 <= holding <= nodes:
                is_there = _number(number) >= wanted
                return messages.ListProgress(*wanted, True, is_there, nodes, holding if is_there else 0)
            case _:
                return messages.ListProgress(*wanted, True, data == self._work.published, 0, 0)

    def _call(self, method: str, arguments: tuple[object, ...], what: str, within: float) -> object:
        node = self._work.home().node()
        return self._deliver(StatementCall(node, method, arguments, what, _HINT, within=within, waits=True))


def _number(text: str) -> tuple[int, int]:
    epoch, _, seq = text.partition(".")
    is_one = all(part.isascii() and part.isdigit() and len(part) < 20 for part in (epoch, seq))
    return (int(epoch), int(seq)) if is_one else (0, 0)


def _in_thread(task: Callable[[], None]) -> None:
    threading.Thread(target=task, name="questions to the master", daemon=True).start()
