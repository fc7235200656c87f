"""A plan carried out: what is new is signed first, then what goes is revoked with one list.

Each of the two is one transaction. Where it is cut off between them, nodes have the new grants and
the old ones, the next plan finds the new ones exact, and what is left is to revoke the old.
A plan made from another record, or by another policy, than there is now signs nothing.
"""

import secrets
from collections.abc import Collection

from ca.revocation.lists import RevocationList
from grants.model import ID_SIZE, Draft
from grants.policy.difference import Moment
from rossec.authority.policy_plan import PlanOptions, PolicyPlan, make_plan
from rossec.authority.policyfile import PolicyFile
from rossec.authority.signing import SKEW, SigningAuthority
from rossec.errors import ConfigurationError


def sign_planned(
    authority: SigningAuthority, plan: PolicyPlan, now: int
) -> list[tuple[Draft, bytes]]:
    """Sign and record the grants of a plan, all or none.

    Raises:
        ConfigurationError: the record or the policy has changed since the plan was made, or this is
            an intermediate.
        StoreError: a key was revoked meanwhile.
    """
    drafts = list(plan.drafts(authority.domain, now, lambda: secrets.token_bytes(ID_SIZE)))
    if not drafts:
        plan.policy.check_unchanged()  # what it revokes is to be what this policy denies
        return []

    def check() -> None:
        plan.policy.check_unchanged()
        check_record(authority, plan)

    signed = authority.issue_grants(drafts, now, check)
    return [(draft, data) for (draft, _), data in zip(drafts, signed, strict=True)]


def grant_outright(
    authority: SigningAuthority,
    policy: PolicyFile,
    names: Collection[str],
    now: int,
    *,
    renews: bool = False,
) -> list[tuple[Draft, bytes]]:
    """Sign what `policy` gives the nodes `names` outright and they do not have; revokes nothing.

    `renews`: whether the master can renew grants.

    Raises:
        PolicyRefused: one of them would need more grants than it can present.
        ConfigurationError, StoreError: as `sign_planned`.
    """
    moment = Moment(now, SKEW, renews=renews)
    plan = make_plan(authority.store, policy, PlanOptions(names), moment)
    return sign_planned(authority, plan, now)


def check_record(authority: SigningAuthority, plan: PolicyPlan) -> None:
    """Return if a plan made now would do the same.

    Raises:
        ConfigurationError: it would not.
    """
    if authority.store.log.head(0).size == plan.entries:
        return
    again = make_plan(authority.store, plan.policy, plan.options, plan.moment)
    if (again.nodes, again.pruned) != (plan.nodes, plan.pruned):
        raise ConfigurationError(
            "the authority's record was changed meanwhile, nothing was done",
            "run the command again: it then compares with the record of now",
        )


def revoke_planned(
    authority: SigningAuthority, plan: PolicyPlan, now: int
) -> RevocationList | None:
    """Revoke what goes, and sign the list; None if nothing goes."""
    gone = frozenset(grant.id for grant in plan.revoke)
    if not gone:
        return None
    return authority.revoke_all(gone, f"policy {plan.policy.policy.robot}", now)
