"""What an authority does by its policy, as methods of `AuthorityService`.

Requests are decided and answered, the policy is applied, nodes opt out. What each of these needs is
imported when it is called: most operations of an authority need no policy.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ca.errors import HintedError
from grants.basics import lasting_name
from grants.model import Draft, Grant
from rossec.authority.grant_delivery import RefusedDeposit, require_delivered
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import SKEW, SigningAuthority
from rossec.errors import NotDelivered, PolicyIncomplete
from rossec.home import NodeHome

if TYPE_CHECKING:
    from rossec.authority.approvals import (
        ApprovalQueue,
        Denial,
        PendingApproval,
        VerdictChange,
    )
    from rossec.authority.opt_out import OptOut
    from rossec.authority.policy_plan import PolicyPlan
    from rossec.authority.policyfile import PolicyFile

SignedGrant = tuple[Draft, bytes]


class Decided(NamedTuple):
    """The grants signed, how many rights are allowed and wait for a person, and what is denied."""

    grants: list[SignedGrant]
    allowed: int
    waiting: int
    denied: "list[Denial]"


class PolicyOperations(ABC):
    """The methods of `AuthorityService` that need a policy; `_now` returns seconds since the epoch.

    `rossec_home` is ROSSEC_HOME.
    """

    rossec_home: Path
    _now: Callable[[], int]

    @property
    @abstractmethod
    def home(self) -> AuthorityHome:
        """The directory of the authority, if there is one."""

    @abstractmethod
    def unlock(self) -> SigningAuthority:
        """The authority with its key."""

    @abstractmethod
    def publish(self) -> None:
        """Deliver the newest list to the master."""

    @abstractmethod
    def deposit(self, grants: Iterable[bytes]) -> list[RefusedDeposit]:
        """Deliver grants to their nodes, by the master."""

    @abstractmethod
    def try_to_store(self, data: bytes) -> "RefusedDeposit | None":
        """Store a grant where its node is in this home."""

    @abstractmethod
    def deposit_missing(self) -> "tuple[int, list[RefusedDeposit]]":
        """Deliver the grants in force that the master does not have."""

    def collect_grant_requests(
        self, policy: "PolicyFile", given: Iterable[bytes] = ()
    ) -> list[str]:
        """Record the requests `given` and those in the inbox; returns the errors of the inbox."""
        with self._queue(policy) as queue:
            for data in given:
                queue.add_request(data)
            return queue.read_inbox()

    def pending_grants(self, policy: "PolicyFile") -> "list[PendingApproval]":
        """The collected requests that wait for a person."""
        with self._queue(policy) as queue:
            return [item for item in queue.pending() if not item.is_allowed]

    def decide_grants(self, policy: "PolicyFile") -> Decided:
        """Sign the collected requests that the policy allows; without any, no key is needed.

        One that no grant can have is denied, and keeps no other from its answer.

        Raises:
            PolicyRefused: it allows one, and a test of the policy does not hold.
        """
        with self._queue(policy) as queue:
            pending, grants, refused = queue.pending(), list[SignedGrant](), list["Denial"]()
            allowed = [item for item in pending if item.is_allowed]
            if allowed:
                policy.require_tests()
                grants, refused = queue.sign_each(self.unlock(), allowed, "policy")
            waiting = len(pending) - len(allowed)
            denied = [*queue.denied, *refused]
            return Decided(grants, len(allowed) - len(refused), waiting, denied)

    def approve_grants(
        self, policy: "PolicyFile", beginning: str, change: "VerdictChange"
    ) -> list[SignedGrant]:
        """Approve the one pending request whose id begins so, and sign its grants."""
        with self._queue(policy) as queue:
            chosen = queue.chosen(beginning)
            return queue.sign(self.unlock(), chosen, change, "a person")

    def deny_grants(self, policy: "PolicyFile", beginning: str) -> "list[PendingApproval]":
        """Deny the pending request whose id begins so; returns the rights that were denied."""
        with self._queue(policy) as queue:
            chosen = queue.chosen(beginning)
            for item in chosen:
                queue.deny(item, "a person")
            return chosen

    def opt_out(self, policy: "PolicyFile", name: str, *, is_node: bool = False) -> "OptOut":
        """Deny the topic `name` in the policy, or all topics to the node of that name.

        An anonymous node is denied with all others of its identity: a rule tells them not apart.
        """
        from rossec.authority.opt_out import add_denial  # noqa: PLC0415 - see above

        with contextlib.closing(self.home.store()) as store:
            known = name in {row.name for row in store.identities.all()}
            certified = store.identities.certified_name(name, self._now())
        if certified != name and (is_node or lasting_name(name) != name):
            name, is_node = certified, True
        self.unlock()
        return add_denial(policy, name, self._now(), is_node=is_node or known)

    def revoke_opted_out(self, opted_out: "OptOut") -> list[tuple[Grant, bytes | None]]:
        """Revoke the grants that show what is denied; see `opt_out.revoke_shown`."""
        from rossec.authority.opt_out import revoke_shown  # noqa: PLC0415 - see above

        return revoke_shown(self.unlock(), opted_out, self._now())

    def _queue(self, policy: "PolicyFile") -> "contextlib.closing[ApprovalQueue]":
        from rossec.authority.approvals import ApprovalQueue  # noqa: PLC0415 - see above

        return contextlib.closing(ApprovalQueue(self.home, policy, self._now()))

    def plan_policy(
        self,
        policy: "PolicyFile",
        names: Collection[str] | None = None,
        *,
        renew_due: bool = False,
        prune: bool = False,
    ) -> "PolicyPlan":
        """What applying `policy` would change, for the nodes `names` or for all; needs no key.

        Raises:
            RevocationRefused: as `policy_plan.make_plan`.
            PolicyRefused: a test of the policy does not hold.
        """
        from grants.policy.difference import Moment  # noqa: PLC0415 - see above
        from rossec.authority.policy_plan import PlanOptions, make_plan  # noqa: PLC0415 - see above

        policy.require_tests()
        with contextlib.closing(self.home.store()) as store:
            at = self._now()
            until = self.home.renewed_until(at)
            moment = Moment(
                at, SKEW, renews=at < until, renew_due=renew_due, renewed_until=until or None
            )
            return make_plan(store, policy, PlanOptions(names, prune), moment)

    def grant_outright(self, *names: str, place: Path | None = None) -> list[SignedGrant]:
        """Sign what the policy in force gives the nodes `names` outright, if there is a policy.

        `place`: of its file; None: the usual one. What it no longer allows waits for
        `apply_policy`.

        Raises:
            ConfigurationError, PathRefused, PolicyRefused: the policy cannot be used, or one of its
                tests does not hold.
        """
        from rossec.authority import policy_apply, policyfile  # noqa: PLC0415 - see above

        if self.home.is_intermediate or not policyfile.place(self.rossec_home, place).exists():
            return []
        policy = policyfile.read_policy(self.rossec_home, place, signs=True)
        policy.require_tests()
        at = self._now()
        until = self.home.renewed_until(at)
        return policy_apply.grant_outright(
            self.unlock(), policy, names, at, renewed_until=until or None
        )

    def apply_policy(
        self, plan: "PolicyPlan", report: Callable[[str], None] = lambda _: None
    ) -> list[SignedGrant]:
        """Carry out a plan: sign and deposit what is new, then revoke what goes, and publish that.

        `report` is called with each step that was done. Returns the new grants.

        Raises:
            ConfigurationError, StoreError: as `policy_apply.sign_planned`; nothing was done.
            NotDelivered: all is signed and recorded, but the master did not take all of it.
            PolicyIncomplete: all is done but what is refused for some nodes, each reported.
        """
        from rossec.authority import policy_apply  # noqa: PLC0415 - see above

        authority, failed = self.unlock(), list[HintedError | OSError]()
        listed, left = policy_apply.take_away(authority, plan, self._now())
        if listed is not None:
            report(f"revoked: {len(plan.taken)} (list {listed.seq})")
            self._publish_new(report, failed)
        signed, left = policy_apply.sign_each(authority, left, self._now())
        if signed:
            report(f"signed: {len(signed)}")
        refused = self._deliver_new(signed, left, failed)
        listed = policy_apply.revoke_planned(authority, left, self._now())
        if listed is not None:
            report(f"revoked: {len(left.revoke)} (list {listed.seq})")
            self._publish_new(report, failed)
        if refused and plan.revoke and not failed:  # there may be room for them now
            refused = self.deposit_missing()[1]
        for each in refused:
            report(each.say("a grant"))
        for reason in left.refused:
            report(f"not granted: {reason}")
        if failed:
            raise failed[-1]
        require_delivered(refused)
        require_complete(left)
        return signed

    def _publish_new(
        self, report: Callable[[str], None], failed: list[HintedError | OSError]
    ) -> None:
        """Deliver the list; a failure is kept, since what comes after it does not need it."""
        try:
            self.publish()
        except (HintedError, OSError) as error:
            failed.append(error)
        else:
            report("the master has the new list")

    def complete_policy(self) -> None:
        """Deliver what an interrupted `apply_policy` may have left: grants, and revocations.

        Raises:
            NotDelivered: the master is out of reach, or refuses some of them.
        """
        with contextlib.closing(self.home.store()) as store:
            ours, revoked = store.policy_grants().keys(), store.revoked_entries()
        refused = self._deposit_all() if ours else []
        if not revoked.isdisjoint(ours):
            self.publish()
        require_delivered(refused)

    def _deliver_new(
        self, signed: list[SignedGrant], plan: "PolicyPlan", failed: list[HintedError | OSError]
    ) -> list[RefusedDeposit]:
        """Deliver new grants; returns those that the master refuses, and keeps a failure.

        What is not allowed is revoked all the same.

        Before a revocation, also those that an interrupted command signed. A node of this
        ROSSEC_HOME has its grants as files, also while no master runs.
        """
        try:
            if plan.revoke:
                return self._deposit_all()
            return self.deposit(data for _, data in signed)
        except NotDelivered as error:
            homes = (NodeHome.of(self.rossec_home, draft.subject) for draft, _ in signed)
            if not all(home.path.is_dir() for home in homes):
                failed.append(error)
        except (HintedError, OSError) as error:  # a full disk, or an expired identity of /ca
            failed.append(error)
        return []

    def _deposit_all(self) -> list[RefusedDeposit]:
        """Deliver every grant that its node or the master lacks; returns the refused ones."""
        with contextlib.closing(self.home.store()) as store:
            rules, rows = store.policy_grants(), store.unrevoked_grants()
        refused = []
        for row in rows:
            home = NodeHome.of(self.rossec_home, row.name)
            lacks = home.path.is_dir() and not home.grant_file(row.id).exists()
            if lacks and row.id in rules and self._now() < row.expires:
                refused.append(self.try_to_store(row.data))
        return [each for each in refused if each is not None] + self.deposit_missing()[1]


def require_complete(plan: "PolicyPlan") -> None:
    """Return if all that the policy allows can be in grants.

    Raises:
        PolicyIncomplete: some of it cannot.
    """
    if plan.refused:
        more = len(plan.refused) - 1
        rest = f" (and {more} more)" if more else ""
        raise PolicyIncomplete(
            f"in force, except: {plan.refused[0]}{rest}",
            "write fewer or narrower rules for this node; all others have what the policy says",
        )
