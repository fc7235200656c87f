"""Approving: a statement is prepared, a phone touches it, and what it says is done, once.

The service makes the statement and verifies the touch: whoever asks for it could show a person
anything, and gains nothing. What waits for the key is carried out when it is unlocked, for a day, in
one transaction with the end of the approval; then it has come to nothing.
"""

import contextlib
import logging
import secrets
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from hashlib import sha256
from typing import Any, ClassVar, Final, NamedTuple, TypeVar

from ca.approvals.passkeys import Approval, Assertion
from ca.approvals.statement import ID_SIZE, LIFETIME, Statement, StatementKind, What
from ca.encoding import Value
from ca.errors import ApprovalOver, ApprovalRefused, HintedError, RecordUnusable, TokenRefused
from ca.store.log import ApprovalState
from ca.store.record import Store
from ca.store.values import DAY
from rossec import clock
from rossec.authority.console import messages
from rossec.authority.console.messages import ApprovalOutcome, Prepared, to_value
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.service import AuthorityService
from rossec.errors import AuthorityLocked, KeyServiceRefused, NotDelivered
from rossec.peer_limits import SharedTable, printable

MAX_RESULT: Final = 500  # characters
_T = TypeVar("_T", bound=What)
Wanted = tuple[What, bytes]
"""What a statement is to say, and the payload whose digest it has (empty: it has none)."""


class Shown(NamedTuple):
    """What a phone is shown: the statement, and the payload whose digest it has (empty: it has none)."""

    statement: Statement
    payload: bytes
    end: float  # by the clock that cannot be set


class Approved:
    """What a phone touched, as it is recorded."""

    def __init__(self, approval: Approval) -> None:
        self.statement = approval.read()
        self.approval = approval
        self.id, self.at, self.payload = approval.id, approval.at, approval.payload
        self.reason = f"approval {approval.id.hex()[:8]}"

    def what(self, kind: type[_T]) -> _T:
        assert isinstance(self.statement.what, kind)  # noqa: S101 - of the kind of its act
        return self.statement.what

    def conclude(self, store: Store, result: str, at: int) -> None:
        """Record, in the transaction of the act, that it is done, with a result for people."""
        # Raises `ApprovalOver` if it was done or ended before: so nothing is done twice.
        store.approvals.end(self.id, ApprovalState.DONE, result[:MAX_RESULT], at)


class ApprovedAct(ABC):
    """A kind of act that a phone can approve; `messages.PREPARED` has the arguments of `prepare`."""

    kind: ClassVar[StatementKind]

    @abstractmethod
    def prepare(self, service: AuthorityService, now: int, *arguments: Any, **_: Any) -> Wanted:
        """What the statement says, and its payload: all that it gives away; nothing is given yet."""

    def admit(self, store: Store, approved: Approved) -> str | None:  # noqa: ARG002 - of acts that override
        """In the transaction that records the approval, so of two approvals of one thing one is refused."""
        # Returns the result if it is done thereby; None: `carry_out` follows.
        return None

    def carry_out(self, service: AuthorityService, approved: Approved, now: int) -> None:  # noqa: ARG002 - as above
        raise AssertionError("done when it was approved")

    def made(self, service: AuthorityService, approved: Approved) -> bytes:  # noqa: ARG002 - as above
        return b""


class _Undo(Exception):
    pass


@contextlib.contextmanager
def tried(store: Store) -> Iterator[None]:
    with contextlib.suppress(_Undo), store.transaction():
        yield
        raise _Undo


MAX_OF_KIND: Final = 16
_HINT: Final = "look at the page again, and approve that"


class Statements:
    # Shown, and waiting for a touch: in memory, each used once. One that this process did not make is never
    # approved.

    def __init__(self, elapsed: clock.Seconds | None = None) -> None:
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._lock = threading.Lock()
        self._shown: dict[StatementKind, SharedTable[bytes, Shown]] = {
            kind: SharedTable(MAX_OF_KIND) for kind in StatementKind
        }

    def add(self, statement: Statement, payload: bytes, owner: str = "") -> None:
        # Where there are too many of its kind, the oldest of whoever has most makes room, and none of a phone
        # for one of a session that may only look.
        shown = Shown(statement, payload, self._elapsed() + LIFETIME)
        with self._lock:
            self._drop_old()
            table = self._shown[statement.kind]
            if table.add(statement.id, shown, owner, messages.rank(owner)) is None:
                raise KeyServiceRefused(
                    f"{MAX_OF_KIND} such approvals wait for a touch", "approve them, or wait"
                )

    def take(self, number: bytes, now: int) -> Shown:
        with self._lock:
            self._drop_old()
            taken = [table.pop(number) for table in self._shown.values()]
        found = next(filter(None, taken), None)
        if found is None:
            raise ApprovalRefused("this is not waiting for a touch, or not any more", _HINT)
        # By the host's clock too; by the other one it ended above, so a clock set back makes nothing last.
        if not found.statement.made <= now <= found.statement.until:
            raise ApprovalRefused("the touch came too late, or the clock was set", _HINT)
        return found

    def _drop_old(self) -> None:
        now = self._elapsed()
        for table in self._shown.values():
            table.drop(lambda shown: now >= shown.end)


MAX_REQUESTS: Final = 32


class LookersRequests:
    # Preparing an enrollment records its request for a day. The record has room for 256, and one who only
    # looks could fill it: so a few of theirs are all there are at a time.

    def __init__(self) -> None:
        self._prepared: dict[bytes, None] = {}

    def check(self, home: AuthorityHome, arguments: Sequence[Value], owner: str, now: int) -> None:
        if messages.rank(owner) or not arguments or not isinstance(arguments[0], bytes):
            return
        with closing(home.store()) as store:
            waiting = {row.digest for row in store.requests.open(now)}
        digest = sha256(arguments[0]).digest()
        self._prepared = {each: None for each in self._prepared if each in waiting}
        if digest in waiting:
            return
        if len(self._prepared) >= MAX_REQUESTS:
            raise KeyServiceRefused(
                f"{MAX_REQUESTS} nodes wait that were added without a phone",
                "approve or deny them, or log in with the phone",
            )
        self._prepared[digest] = None


WAITS: Final = DAY  # seconds after the end of a statement in which it is carried out
KINDS: Final = {name: StatementKind[name.upper().replace("-", "_")] for name in messages.PREPARED}
# It is carried out later: the reason is not in what was approved.
_LATER: Final = (AuthorityLocked, NotDelivered, RecordUnusable, TokenRefused, KeyServiceRefused)
_PREPARING: Final = "preparing an approval"
_log = logging.getLogger("rossec.authority.service")


class ApprovalDependencies(NamedTuple):
    """`audit`: writes a line. Raises `HintedError` if it cannot. `wake`: begins a round of the service,
    which tells the master. `counter`: of a passkey at its last login.
    """

    work: AuthorityWork
    audit: Callable[[str], None]
    wake: Callable[[], None]
    counter: Callable[[bytes], int]


class Approving:
    """`of`: the rest of the service. `acts`: each kind that can be approved. `elapsed`: seconds of a clock
    that cannot be set.
    """

    def __init__(
        self,
        needs: ApprovalDependencies,
        acts: Mapping[StatementKind, ApprovedAct],
        elapsed: clock.Seconds | None = None,
    ) -> None:
        self._needs = needs
        self._work = needs.work
        self._acts = acts
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._statements = Statements(self._elapsed)
        self._lookers = LookersRequests()
        self._carrying_out = threading.Lock()
        self._ends: dict[bytes, float] = {}  # by the clock that cannot be set

    def prepare(self, name: str, arguments: list[Value], owner: str = "") -> Value:
        # Make a statement for `owner`, with all that it would give away.
        kind, at = KINDS[name], self._work.now()
        if tuple(map(type, arguments)) != messages.PREPARED[name]:  # whoever calls this, not only the socket
            raise KeyServiceRefused(f"these are not the arguments of {name}", "")
        with self._work.service(_PREPARING) as service:
            if kind is StatementKind.ENROLL:
                self._lookers.check(service.home, arguments, owner, at)
            what, payload = self._acts[kind].prepare(service, at, *arguments)
            with closing(service.home.store()) as store:
                phones = store.passkeys.active()
                if not phones:
                    raise ApprovalRefused(
                        "there is no phone that could approve this",
                        "set one up with a code from the terminal: rossec console phone",
                    )
                head, domain, number = store.log.head(at), service.home.domain, secrets.token_bytes(ID_SIZE)
                until = at + LIFETIME
                statement = Statement(kind, number, domain, at, until, head.size, head.root, what)
        statement.check_payload(payload)
        self._statements.add(statement, payload, owner)
        data, challenge, phone_ids = statement.to_bytes(), statement.challenge, tuple(p.id for p in phones)
        return to_value(Prepared(number, data, challenge, until, phones[-1].rp_id, phone_ids, payload))

    def approve(self, number: bytes, *assertion: bytes) -> Value:
        at = self._work.now()
        # 1. What was shown is taken, and so used up: also by a touch that is refused below.
        shown = self._statements.take(number, at)
        approval = Approval.of(shown.statement, shown.payload, Assertion(*assertion), at)
        approved = Approved(approval)
        self._ends[approval.id] = self._elapsed() + LIFETIME + WAITS
        # 2. The touch is verified and recorded, the act admitted and audited, together or not at all.
        with self._work.record() as store, store.transaction():
            store.approvals.add(approval, self._needs.counter(approval.passkey))
            result = self._acts[shown.statement.kind].admit(store, approved)
            if result is not None:
                store.approvals.end(approval.id, ApprovalState.DONE, result, at)
            # Last: where no line can be written, the transaction is undone.
            self._needs.audit(f"{self._named(store, approved)}: approved at the console")
        # 3. What needs the key is carried out now, or when it is unlocked.
        if result is None:
            self._carry_out(approved)
        self._needs.wake()
        return self.outcome(approval.id)

    def outcome(self, number: bytes) -> Value:
        with self._work.service(_PREPARING) as service:
            with closing(service.home.store()) as store:
                approval = store.approvals.get(number)
                end = store.approvals.ends().get(number)
            state = ApprovalState.WAITING if end is None else ApprovalState(end.state)
            data = b""
            if state is ApprovalState.DONE and approval.kind in self._acts:
                data = self._acts[StatementKind(approval.kind)].made(service, Approved(approval))
        return to_value(ApprovalOutcome(number, str(state), "" if end is None else end.result, data))

    def carry_out_waiting(self) -> None:
        with self._work.record() as store:
            waiting = store.approvals.waiting()
        for approval in waiting:
            approved = Approved(approval)
            left = approved.statement.until + WAITS - self._work.now()
            is_late = left < 0
            # What another process of the service recorded is counted from when this one first saw it.
            left = LIFETIME + WAITS if is_late else min(LIFETIME + WAITS, left)
            if self._elapsed() > self._ends.setdefault(approved.id, self._elapsed() + left):
                self._end(approved, ApprovalState.EXPIRED, "it waited for the key too long")
            elif not is_late and not self._work.is_locked:
                self._carry_out(approved)

    def _carry_out(self, approved: Approved) -> None:
        # Carry out, unless that is not possible now.
        act, at = self._acts.get(approved.statement.kind), self._work.now()
        if act is None or at < approved.at:  # a clock that was set back: nothing recorded as of later
            return
        # One at a time: a round of the service and a touch may both find it waiting.
        with self._carrying_out, self._work.record() as store:
            if store.approvals.state(approved.id) is not ApprovalState.WAITING:
                return
            purpose = self._named(store, approved)
            try:
                with self._work.service(purpose) as service:
                    act.carry_out(service, approved, at)
            except _LATER as error:
                _log.info("%s waits: %s", purpose, printable(str(error)))
            except HintedError as error:
                # It cannot be done, unless it was and only what follows failed.
                if store.approvals.state(approved.id) is ApprovalState.WAITING:
                    self._end(approved, ApprovalState.FAILED, printable(str(error)))
                else:
                    _log.warning("%s: %s", purpose, printable(str(error)))

    def _end(self, approved: Approved, state: ApprovalState, result: str) -> None:
        try:
            with self._work.record() as store:
                at = max(self._work.now(), approved.at)
                store.approvals.end(approved.id, state, result[:MAX_RESULT], at)
        except ApprovalOver:
            return  # it was denied in this moment
        _log.warning("an approval came to nothing: %s", result)

    def _named(self, store: Store, approved: Approved) -> str:
        used = approved.approval.passkey
        name = next((each.name for each in store.passkeys.all() if each.id == used), "?")
        kind = approved.statement.kind.name.lower().replace("_", " ")
        digest = approved.statement.challenge.hex()
        which = f"approval {approved.id.hex()} ({kind})"
        return f"{which} by the phone {name!a}, statement SHA-256 {digest}"
