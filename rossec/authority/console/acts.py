"""What an act is that a phone approves: it is prepared, admitted, and carried out.

Prepared: shown to the person, with all that it gives away; nothing is given. Admitted: in the
transaction that records the approval, so of two approvals of one thing one is refused. Carried out:
now or when the key is unlocked, in one transaction with the end of the approval, so that it is done
once, whenever the process is killed.
"""

import contextlib
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from ca.approvals.approval import Approval
from ca.approvals.statement import Statement, What
from ca.encoding import Value
from ca.store.record import Store
from rossec.authority.service import AuthorityService

Arguments = tuple[Value, ...]
Conclude = Callable[[Store, str], None]
"""Records in the transaction of the act that it is done, with a result for people.

Raises `ApprovalOver` if it was done or ended before."""


class ToApprove(NamedTuple):
    """What a statement says, and the payload whose digest it has; empty: it has none."""

    what: What
    payload: bytes = b""


class Approved(NamedTuple):
    """An approval with its statement, which was verified; `id` is that of both."""

    approval: Approval
    statement: Statement

    @property
    def id(self) -> bytes:
        """16 bytes."""
        return self.approval.id

    @property
    def reason(self) -> str:
        """Why something was done, for the record."""
        return f"approval {self.id.hex()[:8]}"


class Act(Protocol):
    """One kind of act. All methods raise `HintedError` to refuse."""

    def prepare(self, service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """What is to be approved. Gives nothing away."""

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """Check once more, and record; inside the transaction of the approval.

        Returns the result if it is done thereby; None: `carry_out` follows.
        """

    def carry_out(
        self, service: AuthorityService, approved: Approved, conclude: Conclude, now: int, /
    ) -> None:
        """Do it with the key, and `conclude` in the same transaction.

        Raises:
            AuthorityLocked: the key is not held; it is called again.
            NotDelivered: the master is needed, and out of reach; it is called again.
        """

    def made(self, service: AuthorityService, approved: Approved, /) -> bytes:
        """What was made, when it is done; empty: nothing to hand out."""


class Immediate:
    """An act that needs no key: it is done when it is admitted, and hands out nothing."""

    def carry_out(
        self, _service: AuthorityService, _approved: Approved, _conclude: Conclude, _now: int, /
    ) -> None:
        """Not called."""
        raise AssertionError("done when it was approved")

    def made(self, _service: AuthorityService, _approved: Approved, /) -> bytes:
        """Nothing."""
        return b""


class _Undo(Exception):
    """Rolls a transaction back."""


@contextlib.contextmanager
def tried(store: Store) -> Iterator[None]:
    """A transaction that is rolled back: shows whether it would be refused."""
    with contextlib.suppress(_Undo), store.transaction():
        yield
        raise _Undo
