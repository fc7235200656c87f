"""What a phone can approve: identities, intermediates, phones, join codes, the policy, leave to renew.

The request that was shown is the one that is signed: its digest is in the statement. What was
approved while the key is locked is *approved* in the record, and can still be denied. What needs no
key is done in the transaction of its approval.
"""

import logging
import secrets
import threading
from collections.abc import Callable, Mapping
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Final

from ca import bounded, certificates, names, svid
from ca.approvals import statement
from ca.approvals.passkeys import to_approve
from ca.authority import MAX_LIFETIME
from ca.errors import ApprovalRefused, HintedError, StoreError
from ca.keys.signing import thumbprint
from ca.store import log, values
from ca.store.record import CertificateRow, Store
from grants.model import ID_SIZE
from grants.renewal import MAX_DELEGATION, MAX_TICKET, MIN_TICKET, open_delegation
from rossec import clock, peer_limits
from rossec.authority import renewals
from rossec.authority.console import access, grant_requests
from rossec.authority.console.approving import Approved, ApprovedAct, Wanted, tried
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import MAX_USES, check_invitation, make_invitation
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile, PolicyPlan, check_record, sign_each
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.authority.signing import OF_ALL, OWN_NODE, SigningAuthority
from rossec.errors import ConfigurationError, KeyServiceRefused
from rossec.ros.names import MASTER

MAX_SOURCE: Final = 256  # characters
_log = logging.getLogger("rossec.authority.service")


class EnrollAct(ApprovedAct):
    """An identity: CSR, where it came from, for anonymous nodes too, lifetime, replaces the key.

    `policy`: the file by which the node gets its first grants.
    """

    kind = statement.StatementKind.ENROLL

    def __init__(self, policy: Path) -> None:
        self._policy = policy

    def prepare(
        self,
        service: AuthorityService,
        now: int,
        csr: bytes,
        source: str,
        wildcard: bool,
        lifetime: int,
        replaces: bool,
    ) -> Wanted:
        asked = svid.check_request(csr, service.home.domain, wildcard=wildcard)
        if asked.name == OWN_NODE:
            raise KeyServiceRefused(
                f"{OWN_NODE} is the authority's own node", "choose another name for the node"
            )
        _check_lifetime(lifetime)
        what = statement.Enroll(asked.digest, asked.name, asked.thumbprint, wildcard, lifetime, replaces)
        with closing(service.home.store()) as store:
            if store.identities.issued_for(asked.digest) is None:
                store.requests.add(asked, csr, peer_limits.printable(source)[:MAX_SOURCE], now)
            with tried(store):
                _approve(store, what, now, "")
        return what, csr

    def admit(self, store: Store, approved: Approved) -> str | None:
        _approve(store, approved.what(statement.Enroll), approved.at, approved.reason)
        return None

    def carry_out(self, service: AuthorityService, approved: Approved, now: int) -> None:
        what, authority = approved.what(statement.Enroll), service.unlock()
        store, key = authority.store, what.name if what.replaces else None
        with store.transaction():
            # 1. The request is still as it was approved: meanwhile it may have been denied, or have expired.
            if store.identities.issued_for(what.csr) is None:
                row = store.requests.find(what.csr)
                expired = row is None or now > row.expires
                if row is None or expired or row.state is not values.RequestState.APPROVED:
                    state = "has expired" if row is None or expired else f"was {row.state}"
                    because = "" if row is None or expired or not row.reason else f": {row.reason}"
                    raise StoreError(f"the request of {what.name} {state}{because}", "ask the node again")
                if (row.wildcard, row.replaces) != (what.wildcard, what.replaces):
                    raise StoreError(f"the request of {what.name} was approved otherwise", "look at it")
            # 2. The identity and the end of the approval, together.
            authority.issue(approved.payload, now, what.lifetime, replace_key=key, wildcard=what.wildcard)
            approved.conclude(store, f"{what.name} is enrolled", now)
        # 3. What the policy gives the name; the identity is signed by then, so a mistake is logged.
        try:
            for _, data in service.policy.grant_outright(what.name, place=self._policy):
                service.grants.store(data)
        except HintedError as error:
            _log.error("%s has no grants yet: %s", what.name, peer_limits.printable(str(error)))

    def made(self, service: AuthorityService, approved: Approved) -> bytes:
        with closing(service.home.store()) as store:
            found = store.identities.issued_for(approved.what(statement.Enroll).csr)
        return b"" if found is None else _bundle(service.home, found)


class IntermediateAct(ApprovedAct):
    kind = statement.StatementKind.INTERMEDIATE

    def prepare(
        self, service: AuthorityService, _now: int, csr: bytes, enrolls: bool, lifetime: int
    ) -> Wanted:
        home = service.home
        if home.is_intermediate:
            raise KeyServiceRefused("an intermediate makes no other", "do it at the root")
        _check_lifetime(lifetime)
        key = thumbprint(certificates.check_intermediate_request(csr, home.domain))
        with closing(home.store()) as store:
            store.identities.check_not_revoked("the intermediate", key)
        return statement.IntermediateStatement(sha256(csr).digest(), enrolls, lifetime), csr

    def carry_out(self, service: AuthorityService, approved: Approved, now: int) -> None:
        what, authority = approved.what(statement.IntermediateStatement), service.unlock()
        csr = approved.payload
        with authority.store.transaction():
            name, _ = renewals.sign_intermediate(
                authority, csr, now, may_enroll=what.enrolls, lifetime=what.lifetime
            )
            approved.conclude(authority.store, f"signed {name}", now)

    def made(self, service: AuthorityService, approved: Approved) -> bytes:
        home = service.home
        key = thumbprint(certificates.check_intermediate_request(approved.payload, home.domain))
        with closing(home.store()) as store:
            found = store.identities.by_name(f"{values.INTERMEDIATE}{key.hex()[:16]}")
        return _bundle(home, found[-1]) if found else b""


def _approve(store: Store, what: statement.Enroll, at: int, reason: str) -> None:
    if store.identities.issued_for(what.csr) is not None:
        store.identities.check_not_revoked(what.name, what.key)
        return
    if store.requests.find(what.csr) is None:
        raise StoreError("the request has expired", "make a new request on the node")
    replaced = what.name if what.replaces else None
    store.requests.approve(what.csr, at, reason, replace_key=replaced, wildcard=what.wildcard)


def _check_lifetime(lifetime: int) -> None:
    if not 0 < lifetime <= MAX_LIFETIME:
        raise KeyServiceRefused(f"a lifetime of {lifetime} s where 1 to {MAX_LIFETIME} are allowed", "")


def _bundle(home: AuthorityHome, row: CertificateRow) -> bytes:
    own = home.intermediate()
    return certificates.to_pem(row.der, *([] if own is None else [own]), home.anchor().certificate)


MAX_INVITATION: Final = 30 * 86400  # seconds
MIN_INVITATION: Final = 60
MAX_CODES: Final = 32  # that can be shown again
CODES_KEPT: Final = 600.0  # seconds


class PasskeyAct(ApprovedAct):
    kind = statement.StatementKind.PASSKEY

    def __init__(self, proposals: access.Proposals) -> None:
        self._proposals = proposals

    def prepare(self, service: AuthorityService, now: int, number: bytes) -> Wanted:
        passkey = self._proposals.get(number)
        with closing(service.home.store()) as store, tried(store):
            store.passkeys.add(passkey._replace(at=now))
        return to_approve(passkey), b""

    def admit(self, store: Store, approved: Approved) -> str | None:
        what = approved.what(statement.NewPasskey)
        for shown in self._proposals.all():
            passkey = self._proposals.get(shown.id)
            if to_approve(passkey) == what:
                break
        else:
            raise ApprovalRefused("this phone does not wait any more", "propose it again")
        # Also here: of two proposals of different pages that are approved, the second is refused.
        access.check_bound(store.passkeys.active(), passkey.origin, passkey.rp_id)
        store.passkeys.add(passkey._replace(approval=approved.id, at=approved.at))
        self._proposals.drop(shown.id)
        return f"{passkey.name} can approve"


class InvitationAct(ApprovedAct):
    """A join code: pattern, uses, seconds, for anonymous nodes too.

    `address`: where nodes reach the join port, `host:port`.
    """

    kind = statement.StatementKind.INVITATION

    def __init__(
        self, home: AuthorityHome, address: Callable[[], str], elapsed: clock.Seconds | None = None
    ) -> None:
        self._home = home
        self._address = address
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._lock = threading.Lock()
        self._codes: bounded.ExpiringTable[bytes, bytes] = bounded.ExpiringTable(MAX_CODES, CODES_KEPT)

    def prepare(
        self, _service: AuthorityService, now: int, pattern: str, uses: int, seconds: int, wildcard: bool
    ) -> Wanted:
        # Check what it would allow.
        check_invitation(pattern, wildcard=wildcard)
        if not (1 <= uses <= MAX_USES and MIN_INVITATION <= seconds <= MAX_INVITATION):
            raise KeyServiceRefused(f"a join code is for 1 to {MAX_USES} nodes, and for at most 30 days", "")
        self._address()
        return statement.Invitation(pattern, uses, now + seconds, wildcard), b""

    def admit(self, store: Store, approved: Approved) -> str | None:
        what = approved.what(statement.Invitation)
        given, address = (what.pattern, what.uses, what.until), self._address()
        code, row = make_invitation(self._home, *given, address, approved.at, wildcard=what.wildcard)
        store.invitations.add(row)
        with self._lock:
            self._codes.put(approved.id, code.text().encode(), self._elapsed())
        return f"join code {row.id.hex()[:8]}"

    def made(self, _service: AuthorityService, approved: Approved) -> bytes:
        with self._lock:
            return self._codes.get(approved.id, self._elapsed()) or b""


class RevokeMasterAct(ApprovedAct):
    kind = statement.StatementKind.REVOKE_MASTER

    def prepare(self, service: AuthorityService, now: int, reason: str, master: str) -> Wanted:
        if not names.is_master_name(master):
            raise KeyServiceRefused("these are not the arguments of a revocation", "")
        if service.home.is_intermediate:
            raise ConfigurationError("an intermediate cannot revoke", "do it at the root")
        with closing(service.home.store()) as store:
            grant_requests.keys_of(master)(store, now)
        return statement.RevokeMaster(grant_requests.checked_reason(reason), master), b""

    def admit(self, store: Store, approved: Approved) -> str | None:
        what, at = approved.what(statement.RevokeMaster), approved.at
        for entry in sorted(grant_requests.keys_of(what.master)(store, at)):
            store.revoke(entry, what.reason or approved.reason, at)
        return f"{what.master} is revoked"


NONE_BEFORE: Final = bytes(32)  # the digest of the policy before the first one
_AGAIN: Final = "look at the difference again, and approve that"
_LATER: Final = "it is tried again"


class PolicyAct(ApprovedAct):
    kind = statement.StatementKind.POLICY

    def __init__(self, policy: Path) -> None:
        self._policy = policy

    def prepare(self, service: AuthorityService, _now: int, digest: bytes) -> Wanted:
        if service.home.is_intermediate:
            raise KeyServiceRefused("an intermediate signs no grants", "do it at the root")
        file = self._read(digest)
        plan = service.policy.plan(file)
        if plan.is_empty:
            raise ConfigurationError("this policy is in force already", "there is nothing to do")
        with closing(service.home.store()) as store:
            old = _last_approved(store)
        what = statement.PolicyChange(old, digest, plan.effect(service.home.domain))
        return what, file.text.encode()

    def admit(self, store: Store, approved: Approved) -> str | None:
        # Return if no other policy was approved since it was shown.
        what = approved.what(statement.PolicyChange)
        self._read(what.new)
        if _last_approved(store) != what.old:
            raise StoreError("another policy was approved meanwhile", _AGAIN)
        return None

    def carry_out(self, service: AuthorityService, approved: Approved, now: int) -> None:
        what, authority = approved.what(statement.PolicyChange), service.unlock()
        # 1. The file and what it would change are still those that were approved.
        plan = service.policy.plan(self._read(what.new))
        if plan.effect(authority.domain) != what.effect:
            raise StoreError("what this policy would change is not what was approved", _AGAIN)
        # 2. What is new is signed, what goes is revoked and the approval ends, in one transaction.
        signed = _put_in_force(authority, plan, approved, now)
        # 3. Nodes get the grants, and the master the list.
        try:
            if plan.revoke:
                service.grants.deposit(signed)
            for data in signed:
                service.grants.try_to_store(data)
        finally:  # a grant that cannot be delivered holds no revocation back
            if plan.revoke:
                service.publish()

    def _read(self, digest: bytes) -> PolicyFile:
        file = PolicyFile.read(self._policy, own=True)
        if sha256(file.text.encode()).digest() != digest:
            raise ConfigurationError("the policy file was changed since it was shown", _AGAIN)
        return file


class DelegateAct(ApprovedAct):
    """Leave for the master to renew grants: for how long, and the longest time of a renewed grant.

    Its serial is the id of the approval: signed again after a crash, it is the same.
    """

    kind = statement.StatementKind.DELEGATE

    def prepare(self, service: AuthorityService, now: int, lifetime: int, max_ttl: int) -> Wanted:
        if service.home.is_intermediate:
            raise KeyServiceRefused("an intermediate delegates nothing", "do it at the root")
        if not 0 < lifetime <= MAX_DELEGATION or not MIN_TICKET <= max_ttl <= MAX_TICKET:
            raise KeyServiceRefused(
                f"at most {MAX_DELEGATION} s, and {MIN_TICKET} to {MAX_TICKET} s at a time", ""
            )
        with closing(service.home.store()) as store:
            holder = store.valid_certificate(MASTER, now).thumbprint
        return statement.DelegateStatement(holder, lifetime, max_ttl), b""

    def admit(self, store: Store, approved: Approved) -> str | None:
        _check_holder(store, approved, approved.at)
        return None

    def carry_out(self, service: AuthorityService, approved: Approved, now: int) -> None:
        what, authority = approved.what(statement.DelegateStatement), service.unlock()
        _check_holder(authority.store, approved, now)
        data = authority.issue_delegation(
            what.holder, what.lifetime, what.max_ttl, approved.at, serial=approved.id
        )
        node = service.home.node()
        service.deliver(StatementCall(node, "rossec.updateDelegation", (data,), "the delegation", _LATER))
        given = open_delegation(data, authority.signer.public_key)
        # Only when the master has it: grants count as renewed from then on.
        service.home.confirm_delegation(given.id, now)
        approved.conclude(authority.store, f"{MASTER} may renew grants", now)


def _last_approved(store: Store) -> bytes:
    ends = store.approvals.ends()
    found = [
        approval.subject
        for approval in store.approvals.all()
        if approval.kind == statement.StatementKind.POLICY
        and approval.id in ends
        and ends[approval.id].state == log.ApprovalState.DONE
    ]
    return found[-1] if found else NONE_BEFORE


def _put_in_force(authority: SigningAuthority, plan: PolicyPlan, approved: Approved, now: int) -> list[bytes]:
    reason, revoked = f"policy, {approved.reason}", sorted(grant.id for grant in plan.revoke)

    def check() -> None:
        plan.policy.check_unchanged()
        check_record(authority, plan)
        for entry in revoked:
            authority.store.revoke(entry, reason, now)
        approved.conclude(authority.store, _done(plan.signs, len(revoked), plan), now)

    drafts = list(plan.drafts(authority.domain, now, lambda: secrets.token_bytes(ID_SIZE)))
    try:
        return authority.issue_grants(drafts, now, check)
    except OF_ALL:
        raise
    except HintedError as refusal:
        # What cannot be in a grant keeps no other node from its own.
        with authority.store.transaction():
            signed, left = sign_each(authority, plan, now)
            if not signed and not left.revoke:
                raise refusal from None
            for grant in left.revoke:
                authority.store.revoke(grant.id, reason, now)
            authority.refresh_list(now)
            approved.conclude(authority.store, _done(len(signed), len(left.revoke), left), now)
        return [data for _, data in signed]


def _done(signed: int, revoked: int, plan: PolicyPlan) -> str:
    done = f"{signed} grant{'' if signed == 1 else 's'} signed, {revoked} revoked"
    if not plan.refused:
        return done
    more = f" (and {len(plan.refused) - 1} more)" if len(plan.refused) > 1 else ""
    return f"{done}; not granted: {plan.refused[0]}{more}"


def _check_holder(store: Store, approved: Approved, now: int) -> None:
    what = approved.what(statement.DelegateStatement)
    if store.valid_certificate(MASTER, now).thumbprint != what.holder:
        raise StoreError(f"{MASTER} has another key now", "look at it again")


def acts_of(
    work: AuthorityWork,
    held: access.ConsoleAccess,
    join_address: Callable[[], str],
    elapsed: clock.Seconds | None = None,
) -> Mapping[statement.StatementKind, ApprovedAct]:
    """What a phone can approve; `elapsed` counts seconds and cannot be set."""
    policy = work.policy_path()
    acts: tuple[ApprovedAct, ...] = (
        EnrollAct(policy),
        grant_requests.GrantAct(policy),
        PolicyAct(policy),
        DelegateAct(),
        IntermediateAct(),
        PasskeyAct(held.proposed),
        InvitationAct(work.home(), join_address, elapsed),
        RevokeMasterAct(),
    )
    return {act.kind: act for act in acts}
