"""Approving what needs no key: another passkey, a join code, the end of the master.

They are done in the transaction of their approval, also while the key is locked. A code exists in
memory only, as where a command prints it: the record has the public half of its key.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import closing
from typing import Final

from ca.approvals.assertion import Passkey
from ca.approvals.registration import to_approve
from ca.approvals.statement import Invitation, NewPasskey, RevokeMaster
from ca.errors import PasskeyUnknown
from ca.names import is_master_name
from ca.store.record import Store
from rossec import clock
from rossec.authority.console.access import check_bound
from rossec.authority.console.acts import Approved, Arguments, Immediate, ToApprove, tried
from rossec.authority.console.proposals import Proposals
from rossec.authority.console.removals import checked_reason, keys_of
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import MAX_USES, check_invitation, make_invitation
from rossec.authority.service import AuthorityService
from rossec.errors import ConfigurationError, KeyServiceRefused

MAX_INVITATION: Final = 30 * 86400  # seconds
MIN_INVITATION: Final = 60
MAX_CODES: Final = 32  # that can be shown again
CODES_KEPT: Final = 600.0  # seconds


class PasskeyAct(Immediate):
    """Another passkey: the proposal."""

    def __init__(self, proposals: Proposals) -> None:
        self._proposals = proposals

    def prepare(self, service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """Find the proposal."""
        match arguments:
            case [bytes(number)]:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of a passkey", "")
        passkey = self._proposals.get(number)
        with closing(service.home.store()) as store, tried(store):
            store.passkeys.add(passkey._replace(at=now))
        return ToApprove(to_approve(passkey))

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """Add it."""
        number, passkey = self._find(approved)
        check_bound(store.passkeys.active(), passkey.origin, passkey.rp_id)
        store.passkeys.add(passkey._replace(approval=approved.id, at=approved.approval.at))
        self._proposals.drop(number)
        return f"{passkey.name} can approve"

    def _find(self, approved: Approved) -> tuple[bytes, Passkey]:
        """The proposal that was approved.

        Raises:
            PasskeyUnknown: its time is over.
        """
        what = approved.statement.what
        assert isinstance(what, NewPasskey)  # noqa: S101 - of this kind
        for shown in self._proposals.all():
            passkey = self._proposals.get(shown.id)
            if to_approve(passkey) == what:
                return shown.id, passkey
        raise PasskeyUnknown("this phone does not wait any more", "propose it again")


class InvitationAct(Immediate):
    """A join code: pattern, uses, seconds, for anonymous nodes too.

    `address`: where nodes reach the join port, `host:port`.
    """

    def __init__(
        self, home: AuthorityHome, address: Callable[[], str], elapsed: clock.Seconds | None = None
    ) -> None:
        self._home = home
        self._address = address
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._lock = threading.Lock()
        self._codes: OrderedDict[bytes, tuple[str, float]] = OrderedDict()

    def prepare(self, _service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """Check what it would allow."""
        match arguments:
            case [str(pattern), int(uses), int(seconds), bool(wildcard)]:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of a join code", "")
        check_invitation(pattern, wildcard=wildcard)
        if not (1 <= uses <= MAX_USES and MIN_INVITATION <= seconds <= MAX_INVITATION):
            raise KeyServiceRefused(
                f"a join code is for 1 to {MAX_USES} nodes, and for at most 30 days", ""
            )
        self._address()
        return ToApprove(Invitation(pattern, uses, now + seconds, wildcard))

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """Make it."""
        what = approved.statement.what
        assert isinstance(what, Invitation)  # noqa: S101 - of this kind
        code, row = make_invitation(
            self._home, what.pattern, what.uses, what.until, self._address(),
            approved.approval.at, wildcard=what.wildcard,
        )  # fmt: skip
        store.invitations.add(row)
        with self._lock:
            self._codes[approved.id] = code.text(), self._elapsed() + CODES_KEPT
            while len(self._codes) > MAX_CODES:
                self._codes.popitem(last=False)
        return f"join code {row.id.hex()[:8]}"

    def made(self, _service: AuthorityService, approved: Approved, /) -> bytes:
        """The text of the code, for some minutes."""
        with self._lock:
            text, end = self._codes.get(approved.id, ("", 0.0))
        return text.encode() if self._elapsed() < end else b""


class RevokeMasterAct(Immediate):
    """The end of a master: the reason, and which."""

    def prepare(self, service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """Find its keys."""
        match arguments:
            case [str(reason), str(master)] if is_master_name(master):
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of a revocation", "")
        if service.home.is_intermediate:
            raise ConfigurationError("an intermediate cannot revoke", "do it at the root")
        with closing(service.home.store()) as store:
            keys_of(master)(store, now)
        return ToApprove(RevokeMaster(checked_reason(reason), master))

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """Record it; the list is signed with the key, now or when it is unlocked."""
        what, at = approved.statement.what, approved.approval.at
        assert isinstance(what, RevokeMaster)  # noqa: S101 - of this kind
        for entry in sorted(keys_of(what.master)(store, at)):
            store.revoke(entry, what.reason or approved.reason, at)
        return f"{what.master} is revoked"
