"""What an authority does for its users: unlock, decide, sign, record, tell the master.

The command line calls these methods, and other interfaces can: nothing is printed or asked here.
The passphrase comes from a callable, which is called when the key is first needed and once only.
Each method returns what was done; a refusal is raised. Everything signed is recorded before it is
returned. Telling the master is a step of its own (`publish`, `deliver`): the statement is recorded
by then, and what was done can be shown while the master is out of reach.

What the authority does about constrained things, as methods of `AuthorityService`.

A statement, the identity that goes with it, and the end of what it replaces are one transaction:
signed and recorded together, or not at all. A statement reaches its border router as a file, or at
once where that router's directory is in this ROSSEC_HOME.
"""

import contextlib
import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from string import hexdigits
from typing import Final, NamedTuple

from ca.certificates import Identity
from ca.errors import CertificateExpired, ThingRefused
from ca.keys.signing import Signer
from ca.names import is_alias
from ca.revocation.lists import RevocationList
from ca.revocation.trust_status import open_statement
from ca.store.signed_statements import ThingRow
from ca.store.values import INTERMEDIATE, RequestRow, RequestState
from ca.svid import IdentityRequest, check_request
from ca.things.constrained_nodes import Credential, ThingStatement, peek_statement, sign_statement
from grants.model import Draft, Permission
from grants.renewal import OpenDelegation, open_delegation
from rossec import clock
from rossec.authority import domain_operations, renewals, restored_lists, signing
from rossec.authority.domain_operations import DomainOperations
from rossec.authority.grant_operations import (
    Decided,
    GrantDelivery,
    MasterCall,
    PolicyOperations,
    SignedGrant,
)
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import RemoteSigner, running_signer
from rossec.authority.signing import DELEGATIONS, SKEW, SigningAuthority
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from rossec.saved_statements import ThingFiles

SERIAL: Final = 16


@dataclass(frozen=True)
class ThingOrder:
    """What is to be stated.

    Args:
        name: of the thing, and of the node that stands for it.
        border: the name of the border router that serves it.
        credential: how the thing proves who it is.
        lifetime: of the statement, seconds.
        replaced: names of things whose statements end by this one.
        request: for the identity of the node (DER), if it is to be signed as well.
        identity_lifetime: of that identity, seconds.
    """

    name: str
    border: str
    credential: Credential
    lifetime: int
    replaced: frozenset[str] = frozenset()
    request: bytes = b""
    identity_lifetime: int = 0


class SignedThing(NamedTuple):
    """What was signed: the statement, its octets, and the bundle of the identity (PEM) if any."""

    statement: ThingStatement
    data: bytes
    bundle: bytes
    revoked: int


class ThingOperations(ABC):
    """The methods of `AuthorityService` about things; `_now` returns seconds since the epoch.

    `rossec_home` is ROSSEC_HOME.
    """

    rossec_home: Path
    _now: Callable[[], int]

    @property
    @abstractmethod
    def home(self) -> AuthorityHome: ...

    @abstractmethod
    def unlock(self) -> SigningAuthority: ...

    def sign_thing(self, order: ThingOrder) -> SignedThing:
        authority, at = self.unlock(), self._now()
        if not authority.authority.is_root:
            raise ConfigurationError("an intermediate cannot say what a thing is", "at the root")
        if order.name == order.border:
            raise ThingRefused(
                f"{order.name} is the border router, and no thing of its own",
                "a thing has a name of its own: /things/lamp",
            )
        store = authority.store
        with store.transaction():
            router = store.valid_certificate(order.border, at)
            store.identities.check_not_revoked(order.name, order.credential.thumbprint)
            statement = ThingStatement(
                authority.domain,
                order.name,
                order.credential,
                router.thumbprint,
                at - SKEW,
                at + order.lifetime,
                secrets.token_bytes(SERIAL),
            )
            ended = signing.replaced_by(store, order.name, router.thumbprint, order.replaced, at)
            bundle = _certify(authority, order, at)
            ended -= _key_of(authority, order)
            if ended:
                authority.revoke_all(ended, f"replaced by {order.name}", at)
            authority.refresh_list(at)
            data = sign_statement(authority.signer, statement)
            row = ThingRow(
                statement.id, order.name, order.border, data, statement.not_before, statement.expires
            )
            store.things.add(row, statement, at)
        return SignedThing(statement, data, bundle, len(ended))

    def renew_thing(self, name: str, lifetime: int) -> SignedThing:
        # Of a router that has another key by now: the former statement ends.
        at = self._now()
        with contextlib.closing(self.home.store()) as store:
            row = store.things.last(name)
            router = store.valid_certificate(row.border, at)
            held = row.read()
            moved = held.border != router.thumbprint and bool(store.things.ids(name, at))
        replaced = frozenset({name}) if moved else frozenset[str]()
        return self.sign_thing(ThingOrder(name, row.border, held.credential, lifetime, replaced))

    def revoke_thing(self, name: str, reason: str) -> tuple[RevocationList, int]:
        # The node that stands for it keeps its identity, so that a new thing may take its place.
        authority, at = self.unlock(), self._now()
        with authority.store.transaction():
            authority.store.things.get(name, at)
            found = authority.store.things.ids(name, at)
            return authority.revoke_all(found, reason, at), len(found)

    def things(self) -> list[signing.ThingState]:
        with contextlib.closing(self.home.store()) as store:
            return signing.states(store, self._now())

    def store_thing(self, data: bytes, bundle: bytes = b"") -> Path | None:
        # The identity that was signed with it as well, where the key of its node is here.
        statement = peek_statement(data)
        with contextlib.closing(self.home.store()) as store:
            border = store.things.last(statement.name).border
        home, node = (NodeHome.of(self.rossec_home, name) for name in (border, statement.name))
        if not (home.path / "node.key").exists():
            return None
        if bundle and (node.path / "node.key").exists():
            node.install(bundle, self._now())
        files = ThingFiles(home)
        files.install(data)
        return files.path


def _certify(authority: SigningAuthority, order: ThingOrder, now: int) -> bytes:
    if not order.request:
        return b""
    asked = check_request(order.request, authority.domain)
    if asked.name != order.name:
        raise ConfigurationError(
            f"the request is of {asked.name}, not of {order.name}",
            f"on the border router: rossec border add {order.name}",
        )
    replace_key = order.name if order.name in order.replaced else None
    return authority.issue(
        order.request, now, order.identity_lifetime, replace_key=replace_key, source="border"
    )


def _key_of(authority: SigningAuthority, order: ThingOrder) -> frozenset[bytes]:
    if not order.request:
        return frozenset()
    return frozenset({check_request(order.request, authority.domain).thumbprint})


_EXPIRES_SOON: Final = 7 * 86400
_PUBLISH: Final = (
    "the list is signed and stored, but takes effect only when the master has it;"
    " deliver it with: rossec ca publish"
)
_RENEW: Final = "renew it with: rossec ca refresh"
_DELEGATE: Final = "it is signed and stored in {}; start the master and run this again"


class _Signed(NamedTuple):
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
        return AuthorityHome.at(self.rossec_home)

    def unlock(self) -> SigningAuthority:
        """The authority with its key: that of its service where one runs (`rossec ca serve`).

        Otherwise it asks for the passphrase, unless this was done before.
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
            request.digest, request.name, request.thumbprint, csr, source, at, RequestState.ISSUED, "", at
        )

    def request(self, beginning: str) -> RequestRow:
        """The one request for an identity whose id begins so, every digit of it."""
        if not set(beginning) <= set(hexdigits):
            raise ConfigurationError(f"{beginning!a} is not a request id", "see: rossec ca requests")
        with contextlib.closing(self.home.store()) as store:
            return store.requests.begun(beginning)

    def deny_request(self, row: RequestRow, reason: str) -> None:
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
        return renewals.renew_own_node(self.unlock(), self._now())

    def renew(self, name: str, lifetime: int, *, expired: bool = False) -> bytes:
        """Certify the current key of another node again; returns its new bundle (PEM)."""
        if name.startswith(INTERMEDIATE):
            raise ConfigurationError(
                f"{name} is an intermediate", "sign its request again: `rossec ca intermediate sign`"
            )
        return renewals.renew_by_name(self.unlock(), name, self._now(), lifetime, expired=expired)

    def import_identity(self, bundle: bytes, replaced: Collection[str] = ()) -> tuple[Identity, bool]:
        return renewals.import_identity(self.unlock(), bundle, self._now(), replaced)

    def sign_intermediate(self, csr: bytes, *, may_enroll: bool, lifetime: int) -> tuple[str, bytes]:
        """Sign an intermediate; returns its name for revocation, and its bundle (PEM)."""
        return renewals.sign_intermediate(
            self.unlock(), csr, self._now(), may_enroll=may_enroll, lifetime=lifetime
        )

    def revoke_identity(self, name: str, reason: str) -> tuple[RevocationList, int]:
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
        """Revoke what a signed list revokes that this record lacks; returns how many."""
        return restored_lists.take_over(self.unlock(), data, entries, self._now())[1]

    def complete_list(self) -> None:
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
                foreign, root = domain_operations.verify(store, node, certificate, self._now())
                holder = foreign.thumbprint
            elif is_alias(node):
                holder = domain_operations.holder(store, node, self._now())
            else:
                holder = store.valid_certificate(node, self._now()).thumbprint
        authority, at = self.unlock(), self._now()
        draft = Draft(
            domain=authority.domain,
            subject=node,
            holder=holder,
            not_before=at - SKEW,
            expires=at + lifetime,
            cap=at + max(lifetime, renewal),
            serial=secrets.token_bytes(16),
            permissions=permissions,
            may_narrow=may_narrow,
        )
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
        """Deliver what `delegate` returned; from then on grants count as renewed."""
        self.deliver(call)
        self.home.confirm_delegation(delegation.id, self._now())

    def revoke_delegations(self, reason: str) -> tuple[RevocationList, int]:
        return self.unlock().revoke_delegations(reason, self._now())

    def publish(self) -> None:
        """Deliver the newest list to the master, and the list of domains if there is one."""
        home, at = self.home, self._now()
        data, entries = home.newest_statement()
        expires = open_statement(data, home.anchor().public_key).expires
        if at >= expires:
            raise ConfigurationError(
                f"the revocation list expired {format_time(expires)}", "sign it anew with: rossec ca refresh"
            )
        note = f"the revocation list expires {format_time(expires)}; {_RENEW}"
        method = "rossec.updateRevocationTree" if entries else "rossec.updateRevocations"
        statement = (data, entries) if entries else (data,)
        soon = note if at >= expires - _EXPIRES_SOON else ""
        self.deliver(MasterCall(home.node(), method, statement, "the list", _PUBLISH, soon))
        self.publish_domains()

    def deliver(self, call: MasterCall) -> object:
        """Deliver a statement to the master; returns the value of its answer."""
        try:
            call.node.identity(self._now())
        except CertificateExpired as error:
            raise ConfigurationError(
                f"the identity of {call.node.name} has expired by this host's clock, which says"
                f" {format_time(self._now())}: no master accepts it",
                f"renew it: rossec ca renew {call.node.name}",
            ) from error
        return self._deliver(call)
