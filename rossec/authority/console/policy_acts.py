"""Approving a policy, and leave for the master to renew grants.

A policy is put in force if the file and what it would change are still those that were approved.
What is new is signed, what goes is revoked and the approval ends in one transaction; then nodes get
the new grants, and the master the list.
"""

import secrets
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Final

from ca.approvals.statement import Delegate, Kind, PolicyChange
from ca.errors import HintedError, StoreError
from ca.store.approvals import ApprovalState
from ca.store.record import Store
from grants.model import ID_SIZE
from grants.renewal import MAX_DELEGATION, MAX_TICKET, MIN_TICKET, open_delegation
from rossec.authority.console.acts import Approved, Arguments, Conclude, ToApprove
from rossec.authority.grantable import OF_ALL
from rossec.authority.master_call import MasterCall
from rossec.authority.policy_plan import PolicyPlan
from rossec.authority.policyfile import PolicyFile
from rossec.authority.service import AuthorityService
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError, KeyServiceRefused
from rossec.ros.names import MASTER

NONE_BEFORE: Final = bytes(32)  # the digest of the policy before the first one
_AGAIN: Final = "look at the difference again, and approve that"
_LATER: Final = "it is tried again"


class PolicyAct:
    """A policy in force: the digest of its file, as it was shown."""

    def __init__(self, policy: Path) -> None:
        self._policy = policy

    def prepare(self, service: AuthorityService, arguments: Arguments, _now: int, /) -> ToApprove:
        """Compare the file with what is in force."""
        match arguments:
            case [bytes(digest)]:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of a policy", "")
        if service.home.is_intermediate:
            raise KeyServiceRefused("an intermediate signs no grants", "do it at the root")
        file = self._read(digest)
        plan = service.plan_policy(file)
        if plan.is_empty:
            raise ConfigurationError("this policy is in force already", "there is nothing to do")
        with closing(service.home.store()) as store:
            old = _last_approved(store)
        what = PolicyChange(old, digest, plan.effect(service.home.domain))
        return ToApprove(what, file.text.encode())

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """Return if no other policy was approved since it was shown."""
        what = _changed(approved)
        self._read(what.new)
        if _last_approved(store) != what.old:
            raise StoreError("another policy was approved meanwhile", _AGAIN)
        return None

    def carry_out(
        self, service: AuthorityService, approved: Approved, conclude: Conclude, now: int, /
    ) -> None:
        """Sign and revoke, then deliver in this order: no node is without what it keeps."""
        what, authority = _changed(approved), service.unlock()
        plan = service.plan_policy(self._read(what.new))
        if plan.effect(authority.domain) != what.effect:
            raise StoreError("what this policy would change is not what was approved", _AGAIN)
        signed = _put_in_force(authority, plan, approved, conclude, now)
        try:
            if plan.revoke:
                service.deposit(signed)
            for data in signed:
                service.try_to_store(data)
        finally:  # a grant that cannot be delivered holds no revocation back
            if plan.revoke:
                service.publish()

    def made(self, _service: AuthorityService, _approved: Approved, /) -> bytes:
        """Nothing: grants are delivered."""
        return b""

    def _read(self, digest: bytes) -> PolicyFile:
        """The policy, if it is the file with this digest.

        Raises:
            ConfigurationError: it is another.
        """
        file = PolicyFile.read(self._policy, own=True)
        if sha256(file.text.encode()).digest() != digest:
            raise ConfigurationError("the policy file was changed since it was shown", _AGAIN)
        return file


class DelegateAct:
    """Leave for the master to renew grants: for how long, and the longest time of a renewed grant.

    Its serial is the id of the approval: signed again after a crash, it is the same.
    """

    def prepare(self, service: AuthorityService, arguments: Arguments, now: int, /) -> ToApprove:
        """Find the master's key."""
        match arguments:
            case [int(lifetime), int(max_ttl)]:
                pass
            case _:
                raise KeyServiceRefused("these are not the arguments of a delegation", "")
        if service.home.is_intermediate:
            raise KeyServiceRefused("an intermediate delegates nothing", "do it at the root")
        if not 0 < lifetime <= MAX_DELEGATION or not MIN_TICKET <= max_ttl <= MAX_TICKET:
            raise KeyServiceRefused(
                f"at most {MAX_DELEGATION} s, and {MIN_TICKET} to {MAX_TICKET} s at a time", ""
            )
        with closing(service.home.store()) as store:
            holder = store.valid_certificate(MASTER, now).thumbprint
        return ToApprove(Delegate(holder, lifetime, max_ttl))

    def admit(self, store: Store, approved: Approved, /) -> str | None:
        """Return if the master still has this key."""
        _check_holder(store, approved, approved.approval.at)
        return None

    def carry_out(
        self, service: AuthorityService, approved: Approved, conclude: Conclude, now: int, /
    ) -> None:
        """Sign it, and deliver it; it is done when the master has it."""
        what, authority = approved.statement.what, service.unlock()
        assert isinstance(what, Delegate)  # noqa: S101 - of this kind
        _check_holder(authority.store, approved, now)
        data = authority.issue_delegation(
            what.holder, what.lifetime, what.max_ttl, approved.approval.at, serial=approved.id
        )
        node = service.home.node()
        service.deliver(
            MasterCall(node, "rossec.updateDelegation", (data,), "the delegation", _LATER)
        )
        given = open_delegation(data, authority.signer.public_key)
        service.home.confirm_delegation(given.id, now)
        conclude(authority.store, f"{MASTER} may renew grants")

    def made(self, _service: AuthorityService, _approved: Approved, /) -> bytes:
        """Nothing: the master has it."""
        return b""


def _changed(approved: Approved) -> PolicyChange:
    what = approved.statement.what
    assert isinstance(what, PolicyChange)  # noqa: S101 - of this kind
    return what


def _last_approved(store: Store) -> bytes:
    """The digest of the last policy that was approved and put in force."""
    ends = store.approvals.ends()
    found = [
        approval.subject
        for approval in store.approvals.all()
        if approval.kind == Kind.POLICY
        and approval.id in ends
        and ends[approval.id].state == ApprovalState.DONE
    ]
    return found[-1] if found else NONE_BEFORE


def _put_in_force(
    authority: SigningAuthority,
    plan: PolicyPlan,
    approved: Approved,
    conclude: Conclude,
    now: int,
) -> list[bytes]:
    """Sign, revoke and conclude in one transaction; returns the new grants."""
    from rossec.authority.policy_apply import check_record  # noqa: PLC0415 - an apply needs more

    revoked = sorted(grant.id for grant in plan.revoke)

    def check() -> None:
        plan.policy.check_unchanged()
        check_record(authority, plan)
        for entry in revoked:
            authority.store.revoke(entry, f"policy, {approved.reason}", now)
        conclude(
            authority.store,
            _done(plan.signs, len(revoked), plan),
        )

    drafts = list(plan.drafts(authority.domain, now, lambda: secrets.token_bytes(ID_SIZE)))
    try:
        return authority.issue_grants(drafts, now, check)
    except OF_ALL:
        raise
    except HintedError as error:
        return _put_in_force_by_node(authority, plan, approved, conclude, now, error)


def _put_in_force_by_node(
    authority: SigningAuthority,
    plan: PolicyPlan,
    approved: Approved,
    conclude: Conclude,
    now: int,
    refusal: HintedError,
) -> list[bytes]:
    """As `_put_in_force`, without what is refused: of one node it holds up no other."""
    from rossec.authority import policy_apply  # noqa: PLC0415 - an apply needs more

    with authority.store.transaction():
        signed, left = policy_apply.sign_each(authority, plan, now)
        if not signed and not left.revoke:
            raise refusal
        for grant in left.revoke:
            authority.store.revoke(grant.id, f"policy, {approved.reason}", now)
        authority.refresh_list(now)
        conclude(authority.store, _done(len(signed), len(left.revoke), left))
    return [data for _, data in signed]


def _done(signed: int, revoked: int, plan: PolicyPlan) -> str:
    """What was done, and what of the policy is in no grant."""
    done = f"{signed} grant{'' if signed == 1 else 's'} signed, {revoked} revoked"
    if not plan.refused:
        return done
    more = f" (and {len(plan.refused) - 1} more)" if len(plan.refused) > 1 else ""
    return f"{done}; not granted: {plan.refused[0]}{more}"


def _check_holder(store: Store, approved: Approved, now: int) -> None:
    """Return if the master has the key that may renew grants.

    Raises:
        StoreError: it has another, or none.
    """
    what = approved.statement.what
    assert isinstance(what, Delegate)  # noqa: S101 - of this kind
    if store.valid_certificate(MASTER, now).thumbprint != what.holder:
        raise StoreError(f"{MASTER} has another key now", "look at it again")
