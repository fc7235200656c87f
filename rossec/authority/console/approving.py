"""Approving: a statement is prepared, a phone touches it, and what it says is done, once.

The service makes the statement and verifies the touch: whoever asks for it could show a person
anything, and gains nothing. Recording, admitting and auditing are one transaction, before any
signature. What waits for the key is carried out when it is unlocked, for a day; then it has come to
nothing. A clock that was set back carries out nothing that is recorded as of later.
"""

import logging
import secrets
import threading
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Final, NamedTuple

from ca.approvals.approval import Approval
from ca.approvals.assertion import Assertion
from ca.approvals.statement import ID_SIZE, LIFETIME, Kind, Statement, What
from ca.encoding import Value
from ca.errors import ApprovalOver, HintedError, PasskeyUnknown, RecordUnusable, TokenRefused
from ca.store.approvals import ApprovalState
from ca.store.lifecycle import DAY
from ca.store.record import Store
from rossec import clock
from rossec.authority.console.acts import Act, Approved
from rossec.authority.console.lookers import LookersRequests
from rossec.authority.console.records import to_value
from rossec.authority.console.statements import PreparedStatement, Statements
from rossec.authority.console.views import Outcome, Prepared
from rossec.authority.keyservice.work import AuthorityWork
from rossec.errors import AuthorityLocked, KeyServiceRefused, NotDelivered
from rossec.ros.text import printable

WAITS: Final = DAY  # seconds after the end of a statement in which it is carried out
MAX_RESULT: Final = 500  # characters
KINDS: Final[Mapping[str, Kind]] = {
    "enroll": Kind.ENROLL,
    "grant": Kind.GRANT,
    "policy": Kind.POLICY,
    "delegate": Kind.DELEGATE,
    "intermediate": Kind.INTERMEDIATE,
    "passkey": Kind.PASSKEY,
    "invitation": Kind.INVITATION,
    "revoke-master": Kind.REVOKE_MASTER,
}
# It is carried out later: the reason is not in what was approved.
_LATER: Final = (AuthorityLocked, NotDelivered, RecordUnusable, TokenRefused, KeyServiceRefused)
_PREPARING: Final = "preparing an approval"
_log = logging.getLogger("rossec.authority.service")


class Of(NamedTuple):
    """What approving needs of the rest of the service.

    Args:
        work: of the authority.
        audit: writes a line. Raises `HintedError` if it cannot.
        wake: begins a round of the service, which tells the master.
        counter: of a passkey at its last login.
    """

    work: AuthorityWork
    audit: Callable[[str], None]
    wake: Callable[[], None]
    counter: Callable[[bytes], int]


class Approving:
    """The operations of approving.

    Args:
        of: the rest of the service.
        acts: each kind that can be approved.
        elapsed: seconds of a clock that cannot be set.
    """

    def __init__(
        self, of: Of, acts: Mapping[Kind, Act], elapsed: clock.Seconds | None = None
    ) -> None:
        self._of = of
        self._work = of.work
        self._acts = acts
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._statements = Statements(self._elapsed)
        self._lookers = LookersRequests()
        self._carrying_out = threading.Lock()
        self._ends: dict[bytes, float] = {}  # by the clock that cannot be set

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {"prepare": self.prepare, "approve": self.approve, "outcome": self.outcome}

    def prepare(self, name: str, arguments: list[Value], owner: str = "") -> Value:
        """Make a statement for `owner`, with all that it would give away.

        Raises:
            PasskeyUnknown: there is no phone that could approve it.
            HintedError: it would be refused.
        """
        kind, given, at = KINDS[name], tuple(arguments), self._work.now()
        with self._work.service(_PREPARING) as service:
            if kind is Kind.ENROLL:
                self._lookers.check(service.home, given, owner, at)
            wanted = self._acts[kind].prepare(service, given, at)
            with closing(service.home.store()) as store:
                phones = store.passkeys.active()
                if not phones:
                    raise PasskeyUnknown(
                        "there is no phone that could approve this",
                        "set one up with a code from the terminal: rossec console phone",
                    )
                statement = _state(store, kind, service.home.domain, at, wanted.what)
        statement.check_payload(wanted.payload)
        self._statements.add(PreparedStatement(statement, wanted.payload, given), owner)
        return to_value(
            Prepared(
                statement.id, statement.to_bytes(), statement.challenge, statement.until,
                phones[-1].rp_id, tuple(each.id for each in phones), wanted.payload,
            )
        )  # fmt: skip

    def approve(self, number: bytes, *assertion: bytes) -> Value:
        """Verify a touch on a statement, record it, and carry it out or let it wait.

        Raises:
            ApprovalRefused: the statement is unknown, used or late, or this is no touch on it.
            HintedError: what was approved is refused now; nothing is recorded.
        """
        at = self._work.now()
        shown = self._statements.take(number, at)
        statement = shown.statement
        approval = Approval.of(statement, shown.payload, Assertion(*assertion), at)
        approved = Approved(approval, statement)
        self._ends[approval.id] = self._elapsed() + LIFETIME + WAITS
        with closing(self._work.home().store()) as store, store.transaction():
            store.approvals.add(approval, self._of.counter(approval.passkey))
            result = self._acts[statement.kind].admit(store, approved)
            if result is not None:
                store.approvals.end(approval.id, ApprovalState.DONE, result, at)
            self._of.audit(f"{self._named(store, approved)}: approved at the console")
        if result is None:
            self._carry_out(approved)
        self._of.wake()
        return self.outcome(approval.id)

    def outcome(self, number: bytes) -> Value:
        """What came of an approval.

        Raises:
            ApprovalOver: there is none.
        """
        with self._work.service(_PREPARING) as service:
            with closing(service.home.store()) as store:
                approval = store.approvals.get(number)
                end = store.approvals.ends().get(number)
            state = ApprovalState.WAITING if end is None else ApprovalState(end.state)
            data = b""
            if state is ApprovalState.DONE and approval.kind in self._acts:
                approved = Approved(approval, approval.read())
                data = self._acts[Kind(approval.kind)].made(service, approved)
        return to_value(Outcome(number, str(state), "" if end is None else end.result, data))

    def carry_out_waiting(self) -> None:
        """Carry out what waits, oldest first, if the key is held; end what has waited too long."""
        with closing(self._work.home().store()) as store:
            waiting = store.approvals.waiting()
        for approval in waiting:
            approved = Approved(approval, approval.read())
            is_late = self._work.now() > approved.statement.until + WAITS
            if self._is_over(approved, is_late=is_late):
                self._end(approved, ApprovalState.EXPIRED, "it waited for the key too long")
            elif not is_late and not self._work.is_locked:
                self._carry_out(approved)

    def _is_over(self, approved: Approved, *, is_late: bool) -> bool:
        """Whether it has ended for good: by a count of seconds, as a clock may be ahead for once.

        What another process of the service recorded is counted from when this one first saw it.
        """
        left = LIFETIME + WAITS
        if not is_late:
            left = min(left, approved.statement.until + WAITS - self._work.now())
        end = self._ends.setdefault(approved.id, self._elapsed() + left)
        return self._elapsed() > end

    def _carry_out(self, approved: Approved) -> None:
        """Carry out, unless that is not possible now."""
        act, at = self._acts.get(approved.statement.kind), self._work.now()
        if act is None or at < approved.approval.at:
            return

        def conclude(store: Store, result: str) -> None:
            store.approvals.end(approved.id, ApprovalState.DONE, result[:MAX_RESULT], at)

        with self._carrying_out, closing(self._work.home().store()) as store:
            if store.approvals.state(approved.id) is not ApprovalState.WAITING:
                return
            purpose = self._named(store, approved)
            try:
                with self._work.service(purpose) as service:
                    act.carry_out(service, approved, conclude, at)
            except _LATER as error:
                _log.info("%s waits: %s", purpose, printable(str(error)))
            except HintedError as error:
                self._fail(store, approved, error)

    def _fail(self, store: Store, approved: Approved, error: HintedError) -> None:
        """It cannot be done, unless it was and only what follows failed."""
        if store.approvals.state(approved.id) is ApprovalState.WAITING:
            self._end(approved, ApprovalState.FAILED, printable(str(error)))
        else:
            _log.warning("%s: %s", self._named(store, approved), printable(str(error)))

    def _end(self, approved: Approved, state: ApprovalState, result: str) -> None:
        try:
            with closing(self._work.home().store()) as store:
                at = max(self._work.now(), approved.approval.at)
                store.approvals.end(approved.id, state, result[:MAX_RESULT], at)
        except ApprovalOver:
            return  # it was denied in this moment
        _log.warning("an approval came to nothing: %s", result)

    def _named(self, store: Store, approved: Approved) -> str:
        """An approval for the audit: which, of what, by whom."""
        passkey = approved.approval.passkey
        name = next((each.name for each in store.passkeys.all() if each.id == passkey), "?")
        kind = approved.statement.kind.name.lower().replace("_", " ")
        digest = approved.statement.challenge.hex()
        which = f"approval {approved.id.hex()} ({kind})"
        return f"{which} by the phone {name!a}, statement SHA-256 {digest}"


def _state(store: Store, kind: Kind, domain: str, at: int, what: What) -> Statement:
    head = store.log.head(at)
    return Statement(
        kind, secrets.token_bytes(ID_SIZE), domain, at, at + LIFETIME, head.size, head.root, what
    )
