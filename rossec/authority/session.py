"""The authority as one command has it: its key unlocked once, its lists, what is told to the master.

Nothing is printed or asked here: the passphrase comes from a callable, called when the key is first
needed, and once only. Telling the master is a step of its own (`publish`, `deliver`): the statement
is recorded by then, and what was done can be shown while the master is out of reach.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from ca.errors import CertificateExpired
from ca.keys.signing import Signer
from ca.revocation import lists, trust_status
from ca.store.record import Store
from rossec import clock
from rossec.authority import renewals, restored_lists, signing
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import RemoteSigner, running_signer
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.ros.names import UPDATE_DOMAINS

DEPOSIT_SECONDS: Final = 15.0
_EXPIRES_SOON: Final = 7 * 86400
_PUBLISH: Final = (
    "{} is signed and stored, but takes effect only when the master has it;"
    " deliver it with: rossec ca publish"
)


class StatementCall(NamedTuple):
    """A signed statement for the master, or a query: called as `node`, the authority's own.

    `what` names it in errors, `hint` says how to deliver it later, `note` is to be shown if set.
    `within`: seconds until it fails; None: the usual deadlines. `waits`: the master answers when
    there is something new, so that a slow answer is no sign of one that is out of reach.
    """

    node: NodeHome
    method: str
    statement: tuple[object, ...]
    what: str
    hint: str
    note: str = ""
    within: float | None = None
    waits: bool = False


class _Signed(NamedTuple):
    revoked: int
    revocations: tuple[int, int]
    domains: tuple[int, int]


@dataclass(eq=False, repr=False)
class AuthoritySession:
    """The authority below ROSSEC_HOME; for one thread, as its record is.

    `passphrase`: returns the passphrase of the key, or raises. `call_master`: returns the master's
    answer; raises `NotDelivered` if it cannot. `now`: seconds since the epoch. `find_signer`: the key,
    if a service holds it; `running_signer` asks the one that runs.
    """

    rossec_home: Path
    passphrase: Callable[[], str]
    call_master: Callable[[StatementCall], object]
    now: Callable[[], int] = clock.now
    find_signer: Callable[[AuthorityHome], Signer | None] = running_signer
    _unlocked: signing.SigningAuthority | None = field(default=None, init=False)
    _before: _Signed = field(default=_Signed(0, (0, 0), (0, 0)), init=False)

    @property
    def home(self) -> AuthorityHome:
        return AuthorityHome.at(self.rossec_home)

    def record(self) -> closing[Store]:
        return closing(self.home.store())

    def unlock(self) -> signing.SigningAuthority:
        """The authority with its key: that of its service where one runs (`rossec ca serve`)."""
        # Otherwise it asks for the passphrase, unless this was done before.
        if self._unlocked is None:
            home = self.home
            signer = self.find_signer(home)
            authority = home.unlock(self.passphrase()) if signer is None else home.open(signer)
            self._unlocked = authority
            self._before = self._signed()
        return self._unlocked

    def close(self) -> None:
        if self._unlocked is not None:
            if isinstance(self._unlocked.signer, RemoteSigner):
                self._unlocked.signer.close()
            self._unlocked.store.close()
            self._unlocked = None

    def refresh(self) -> tuple[lists.RevocationList, int | None]:
        """Sign the list anew; returns it, and the end of the own node's identity if renewed."""
        # The list of domains, if there is one, is signed anew as well.
        authority, at = self.unlock(), self.now()
        due = renewals.own_node_is_due(authority, at)
        renewed = renewals.renew_own_node(authority, at) if due else None
        if authority.store.domains.newest_list():
            authority.sign_domains(at)
        return authority.sign_list(at), renewed

    def take_over_revocations(self, data: bytes, entries: bytes | None) -> int:
        return restored_lists.take_over(self.unlock(), data, entries, self.now())[1]

    def complete_list(self) -> None:
        self.unlock().refresh_list(self.now())

    def sign_head(self) -> bytes:
        self.complete_list()
        return self.unlock().sign_head(self.now())

    # What was done since the key was unlocked: the master must be told.

    @property
    def has_revoked(self) -> bool:
        return self._signed().revoked != self._before.revoked

    @property
    def has_signed_list(self) -> bool:
        return self._signed().revocations != self._before.revocations

    @property
    def has_signed_domains(self) -> bool:
        return self._signed().domains != self._before.domains

    def _signed(self) -> _Signed:
        if self._unlocked is None:
            return self._before
        store = self._unlocked.store
        return _Signed(store.count_revoked(), store.next_number(), store.domains.next_number())

    def publish(self) -> None:
        home, at = self.home, self.now()
        data, entries = home.newest_statement()
        expires = trust_status.open_statement(data, home.anchor().public_key).expires
        if at >= expires:
            raise ConfigurationError(
                f"the revocation list expired {format_time(expires)}", "sign it anew with: rossec ca refresh"
            )
        note = f"the revocation list expires {format_time(expires)}; renew it with: rossec ca refresh"
        method = "rossec.updateRevocationTree" if entries else "rossec.updateRevocations"
        statement = (data, entries) if entries else (data,)
        soon = note if at >= expires - _EXPIRES_SOON else ""
        hint = _PUBLISH.format("the list")
        self.deliver(StatementCall(home.node(), method, statement, "the list", hint, soon))
        self.publish_domains()

    def publish_domains(self) -> bool:
        home, at = self.home, self.now()
        found = home.domain_list()
        if found is None:
            return False
        data, listed = found
        if at >= listed.expires:
            raise ConfigurationError(
                f"the list of domains expired {format_time(listed.expires)}",
                "sign it anew with: rossec ca refresh",
            )
        what = "the list of domains"
        self.deliver(StatementCall(home.node(), UPDATE_DOMAINS, (data,), what, _PUBLISH.format(what)))
        return True

    def master_has_list(self) -> bool:
        node, what = self.home.node(), "the question for its list"
        method, hint = "rossec.revocationStatus", "rossec ca publish"
        answer = self.deliver(StatementCall(node, method, (), what, hint, within=DEPOSIT_SECONDS))
        newest = trust_status.open_statement(self.home.revocation_list(), self.home.anchor().public_key)
        if self.now() >= newest.expires:
            raise ConfigurationError("the revocation list has expired", "rossec ca refresh")
        epoch, seq = newest.number
        return isinstance(answer, dict) and answer.get("list") == f"{epoch}.{seq}"

    def deliver(self, call: StatementCall) -> object:
        try:
            call.node.identity(self.now())
        except CertificateExpired as error:
            raise ConfigurationError(
                f"the identity of {call.node.name} has expired by this host's clock, which says"
                f" {format_time(self.now())}: no master accepts it",
                f"renew it: rossec ca renew {call.node.name}",
            ) from error
        return self.call_master(call)
