"""What an authority does for its users: unlock, decide, sign, record, tell the master.

The command line calls these methods, and other interfaces can: nothing is printed or asked here.
The passphrase comes from a callable, which is called when the key is first needed and once only.
Each method returns what was done; a refusal is raised. Everything signed is recorded before it is
returned. Telling the master is a step of its own (`publish`, `deliver`): the statement is recorded
by then, and what was done can be shown while the master is out of reach.
"""

import contextlib
import secrets
from collections.abc import Callable, Collection
from pathlib import Path
from string import hexdigits
from typing import Final, NamedTuple

from ca.certificates import Identity, IdentityRequest
from ca.domains.aliases import is_alias
from ca.errors import CertificateExpired
from ca.keys.signer import Signer
from ca.revocation.state import RevocationList, open_statement
from ca.store.lifecycle import RequestRow, RequestState
from ca.store.rows import INTERMEDIATE
from grants.model import Draft, Permission
from grants.renewal import OpenDelegation, open_delegation
from rossec import clock
from rossec.authority import foreign_nodes, renewals, restored_lists
from rossec.authority.domain_operations import DomainOperations
from rossec.authority.grant_delivery import GrantDelivery
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import RemoteSigner, running_signer
from rossec.authority.master_call import MasterCall
from rossec.authority.policy_operations import Decided, PolicyOperations, SignedGrant
from rossec.authority.signing import DELEGATIONS, SKEW, SigningAuthority
from rossec.authority.thing_operations import ThingOperations
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.ros.names import MASTER

_EXPIRES_SOON: Final = 7 * 86400
_PUBLISH: Final = (
    "the list is signed and stored, but takes effect only when the master has it;"
    " deliver it with: rossec ca publish"
)
_RENEW: Final = "renew it with: rossec ca refresh"
_DELEGATE: Final = "it is signed and stored in {}; start the master and run this again"


class _Signed(NamedTuple):
    """How much was revoked, and the numbers of the next lists, at some moment."""

    revoked: int
    revocations: tuple[int, int]
    domains: tuple[int, int]


def _signed(authority: SigningAuthority) -> _Signed:
    store = authority.store
    return _Signed(store.count_revoked(), store.next_number(), store.domains.next_number())


__all__ = ["AuthorityService", "Decided", "MasterCall", "SignedGrant"]


class AuthorityService(GrantDelivery, PolicyOperations, DomainOperations, ThingOperations):
    """The authority below ROSSEC_HOME; for one thread, as its record is.

    Args:
        home: ROSSEC_HOME.
        passphrase: returns the passphrase of the key, or raises.
        deliver: calls the master, returns its answer; raises `NotDelivered` if it cannot.
        now: seconds since the epoch.
        find_signer: the key, if a service holds it; `running_signer` asks the one that runs.
    """

    def __init__(
        self,
        home: Path,
        passphrase: Callable[[], str],
        deliver: Callable[[MasterCall], object],
        now: Callable[[], int] = clock.now,
        find_signer: Callable[[AuthorityHome], Signer | None] = running_signer,
    ) -> None:
        self.rossec_home = home
        self._passphrase = passphrase
        self._deliver = deliver
        self._now = now
        self._find_signer = find_signer
        self._unlocked: SigningAuthority | None = None
        self._before = _Signed(0, (0, 0), (0, 0))

    @property
    def home(self) -> AuthorityHome:
        """The directory of the authority, if there is one."""
        return AuthorityHome.at(self.rossec_home)

    def unlock(self) -> SigningAuthority:
        """The authority with its key: that of its service where one runs (`rossec ca serve`).

        Otherwise it asks for the passphrase, unless this was done before.

        Raises:
            AuthorityLocked: the service runs, and does not hold the key.
            PassphraseRefused: it is wrong; the next call asks again.
        """
        if self._unlocked is None:
            home = self.home
            signer = self._find_signer(home)
            authority = home.unlock(self._passphrase()) if signer is None else home.open(signer)
            self._before = _signed(authority)
            self._unlocked = authority
        return self._unlocked

    def close(self) -> None:
        """Close the record, and forget the key."""
        if self._unlocked is not None:
            if isinstance(self._unlocked.signer, RemoteSigner):
                self._unlocked.signer.close()
            self._unlocked.store.close()
            self._unlocked = None

    def add_request(self, request: IdentityRequest, csr: bytes, source: str) -> RequestRow:
        """Record a request for an identity; returns its row: pending, or answered before."""
        at = self._now()
        with contextlib.closing(self.home.store()) as store:
            if store.identities.issued_for(request.digest) is None:
                return store.requests.add(request, csr, source, at)
        return RequestRow(
            request.digest, request.name, request.thumbprint, csr, source, at,
            RequestState.ISSUED, "", at,
        )  # fmt: skip

    def request(self, beginning: str) -> RequestRow:
        """The one request for an identity whose id begins so, every digit of it.

        Raises:
            ConfigurationError: not hexadecimal digits.
            StoreError: there is none, or more than one.
        """
        if not set(beginning) <= set(hexdigits):
            raise ConfigurationError(
                f"{beginning!a} is not a request id", "see: rossec ca requests"
            )
        with contextlib.closing(self.home.store()) as store:
            return store.requests.begun(beginning)

    def deny_request(self, row: RequestRow, reason: str) -> None:
        """Deny a request for an identity."""
        with contextlib.closing(self.home.store()) as store:
            store.requests.deny(row.digest, self._now(), reason)

    def issue(
        self, csr: bytes, lifetime: int, *, replace_key: str | None, wildcard: bool, source: str
    ) -> bytes:
        """Approve a request and sign its identity; see `SigningAuthority.issue`."""
        return self.unlock().issue(
            csr, self._now(), lifetime, replace_key=replace_key, wildcard=wildcard, source=source
        )

    def renew_own_node(self) -> int:
        """Renew the authority's own node in place; returns when its identity expires."""
        return renewals.renew_own_node(self.unlock(), self._now())

    def renew(self, name: str, lifetime: int, *, expired: bool = False) -> bytes:
        """Certify the current key of another node again; returns its new bundle (PEM)."""
        if name.startswith(INTERMEDIATE):
            raise ConfigurationError(
                f"{name} is an intermediate",
                "sign its request again: `rossec ca intermediate sign`",
            )
        return renewals.renew_by_name(self.unlock(), name, self._now(), lifetime, expired=expired)

    def import_identity(
        self, bundle: bytes, replaced: Collection[str] = ()
    ) -> tuple[Identity, bool]:
        """Record an identity that an intermediate signed; see `renewals.import_identity`."""
        return renewals.import_identity(self.unlock(), bundle, self._now(), replaced)

    def sign_intermediate(
        self, csr: bytes, *, may_enroll: bool, lifetime: int
    ) -> tuple[str, bytes]:
        """Sign an intermediate; returns its name for revocation, and its bundle (PEM)."""
        return renewals.sign_intermediate(
            self.unlock(), csr, self._now(), may_enroll=may_enroll, lifetime=lifetime
        )

    def revoke_identity(self, name: str, reason: str) -> tuple[RevocationList, int]:
        """Revoke every key of `name`; returns the list to publish, and the number of keys."""
        return self.unlock().revoke_identity(name, reason, self._now())

    def intermediates(self) -> list[str]:
        """The intermediates of this root that are valid now."""
        with contextlib.closing(self.home.store()) as store:
            rows = store.identities.all_valid(self._now())
        return sorted({row.name for row in rows if row.name.startswith(INTERMEDIATE)})

    def refresh(self) -> tuple[RevocationList, int | None]:
        """Sign the list anew; returns it, and the end of the own node's identity if renewed.

        The list of domains, if there is one, is signed anew as well.
        """
        authority, at = self.unlock(), self._now()
        due = renewals.own_node_is_due(authority, at)
        renewed = renewals.renew_own_node(authority, at) if due else None
        if authority.store.domains.newest_list():
            authority.sign_domains(at)
        return authority.sign_list(at), renewed

    def take_over_revocations(self, data: bytes, entries: bytes | None) -> int:
        """Revoke what a signed list revokes that this record lacks; returns how many.

        Raises:
            RevocationRefused, BackupRefused: it is not the authority's, or a tree without entries.
        """
        return restored_lists.take_over(self.unlock(), data, entries, self._now())[1]

    def complete_list(self) -> None:
        """Sign the list anew if it lacks a revocation (`AuthorityHome.count_unlisted`)."""
        self.unlock().refresh_list(self._now())

    @property
    def has_revoked(self) -> bool:
        """Whether something was revoked since the key was unlocked: the master must be told."""
        opened = self._unlocked
        return opened is not None and _signed(opened).revoked != self._before.revoked

    @property
    def has_signed_list(self) -> bool:
        """Whether a list was signed since the key was unlocked: the master should get it."""
        opened = self._unlocked
        return opened is not None and _signed(opened).revocations != self._before.revocations

    @property
    def has_signed_domains(self) -> bool:
        """Whether a list of domains was signed since the key was unlocked: likewise."""
        opened = self._unlocked
        return opened is not None and _signed(opened).domains != self._before.domains

    def sign_head(self) -> bytes:
        """Sign the head of the log."""
        self.complete_list()
        return self.unlock().sign_head(self._now())

    def sign_grant(
        self,
        node: str,
        permissions: tuple[Permission, ...],
        lifetime: int,
        renewal: int = 0,
        may_narrow: int = 0,
        certificate: bytes = b"",
    ) -> SignedGrant:
        """Sign a grant for the current key of `node`; the master may renew it for `renewal` s.

        `node` may be an alias: `certificate` (PEM) names its key, else one recorded before. It is
        never renewed: no master of this domain is asked by nodes of others.
        """
        with contextlib.closing(self.home.store()) as store:
            foreign, root = None, b""
            if is_alias(node) and certificate:
                foreign, root = foreign_nodes.verify(store, node, certificate, self._now())
                holder = foreign.thumbprint
            elif is_alias(node):
                holder = foreign_nodes.holder(store, node, self._now())
            else:
                holder = store.valid_certificate(node, self._now()).thumbprint
        authority, at = self.unlock(), self._now()
        draft = Draft(
            domain=authority.domain, subject=node, holder=holder, not_before=at - SKEW,
            expires=at + lifetime, cap=at + max(lifetime, renewal),
            serial=secrets.token_bytes(16), permissions=permissions, may_narrow=may_narrow,
        )  # fmt: skip
        if foreign is not None:
            authority.store.domains.add_certificate(root, foreign, at)
        return draft, authority.issue_grant(draft, at)

    def revoke_grant(self, beginning: str, reason: str) -> tuple[RevocationList, bytes]:
        """Revoke the one grant whose id begins so; returns the list to publish, and the id."""
        with contextlib.closing(self.home.store()) as store:
            known = [row.id for row in store.grants()]
        found = [each for each in known if beginning and each.hex().startswith(beginning.lower())]
        if len(found) != 1:
            count = "several grants begin" if found else "no grant begins"
            raise ConfigurationError(f"{count} with {beginning!r}", "see: rossec grant list")
        return self.unlock().revoke(found[0], reason, self._now()), found[0]

    def delegate(
        self, lifetime: int, max_ttl: int, master: str = MASTER
    ) -> tuple[OpenDelegation, MasterCall]:
        """Let `master` renew grants: sign the delegation, which is to be delivered to it."""
        authority, at = self.unlock(), self._now()
        holder = authority.store.valid_certificate(master, at).thumbprint
        data = authority.issue_delegation(holder, lifetime, max_ttl, at)
        hint = _DELEGATE.format(authority.path / DELEGATIONS)
        call = MasterCall(self.home.node(), "rossec.updateDelegation", (data,), "it", hint)
        return open_delegation(data, authority.signer.public_key), call

    def deliver_delegation(self, delegation: OpenDelegation, call: MasterCall) -> None:
        """Deliver what `delegate` returned; from then on grants count as renewed.

        Raises:
            NotDelivered: as `deliver`; nothing counts as renewed by it.
        """
        self.deliver(call)
        self.home.confirm_delegation(delegation.id, self._now())

    def revoke_delegations(self, reason: str) -> tuple[RevocationList, int]:
        """Revoke every delegation in force; returns the list to publish, and their number."""
        return self.unlock().revoke_delegations(reason, self._now())

    def publish(self) -> None:
        """Deliver the newest list to the master, and the list of domains if there is one.

        Raises:
            ConfigurationError: the list has expired: no grant is valid under it.
            NotDelivered: as `deliver`.
        """
        home, at = self.home, self._now()
        data, entries = home.newest_statement()
        expires = open_statement(data, home.anchor().public_key).expires
        if at >= expires:
            raise ConfigurationError(
                f"the revocation list expired {format_time(expires)}",
                "sign it anew with: rossec ca refresh",
            )
        note = f"the revocation list expires {format_time(expires)}; {_RENEW}"
        method = "rossec.updateRevocationTree" if entries else "rossec.updateRevocations"
        statement = (data, entries) if entries else (data,)
        soon = note if at >= expires - _EXPIRES_SOON else ""
        self.deliver(MasterCall(home.node(), method, statement, "the list", _PUBLISH, soon))
        self.publish_domains()

    def deliver(self, call: MasterCall) -> object:
        """Deliver a statement to the master; returns the value of its answer.

        Raises:
            ConfigurationError: the identity of the authority's own node has expired.
            NotDelivered: the master is unreachable or refuses it; the statement stays recorded.
        """
        try:
            call.node.identity(self._now())
        except CertificateExpired as error:
            raise ConfigurationError(
                f"the identity of {call.node.name} has expired by this host's clock, which says"
                f" {format_time(self._now())}: no master accepts it",
                f"renew it: rossec ca renew {call.node.name}",
            ) from error
        return self._deliver(call)
