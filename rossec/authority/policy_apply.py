"""A plan carried out: what is only taken away goes first; then what is new is signed, and what that
replaces goes, so that no node is without what it keeps.

Each step is one transaction. Where it is cut off between the last two, nodes have the new grants
and the old ones, the next plan finds the new ones exact, and what is left is to revoke the old.
A plan made from another record, or by another policy, than there is now does nothing. Where the
grants of one node cannot be signed, those of the others are, and what it may not have goes.
"""

import secrets
from collections.abc import Collection
from dataclasses import replace

from ca.errors import HintedError
from ca.revocation.lists import RevocationList
from grants.errors import PolicyRefused
from grants.model import ID_SIZE, Draft, Grant
from grants.policy.difference import Moment, NodeDifference
from rossec.authority.grantable import OF_ALL
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


def take_away(
    authority: SigningAuthority, plan: PolicyPlan, now: int
) -> tuple[RevocationList | None, PolicyPlan]:
    """Revoke what is only taken away, if something else is signed; returns what is left to do.

    Raises:
        ConfigurationError: as `sign_planned`.
    """
    taken = plan.taken
    if not taken or not plan.signs:
        return None, plan
    with authority.store.transaction():
        plan.policy.check_unchanged()
        check_record(authority, plan)
        listed = authority.revoke_all(frozenset(each.id for each in taken), _reason(plan), now)
        return listed, plan.without(taken, authority.store.log.head(0).size)


def sign_each(
    authority: SigningAuthority, plan: PolicyPlan, now: int
) -> tuple[list[tuple[Draft, bytes]], PolicyPlan]:
    """As `sign_planned`, and where it refuses, for each node alone.

    Returns the grants, and the plan with what is refused: what it revokes is left to do.

    Raises:
        ConfigurationError: as `sign_planned`.
        HintedError: nothing can be signed at all.
    """
    try:
        return sign_planned(authority, plan, now), plan
    except OF_ALL:
        raise
    except HintedError:
        plan.policy.check_unchanged()
        check_record(authority, plan)
    signed: list[tuple[Draft, bytes]] = []
    nodes, pruned = [], []
    for node in plan.nodes:
        try:
            signed += _sign_alone(authority, replace(plan, nodes=(node,), pruned=()), now)
        except OF_ALL:
            raise
        except HintedError as error:
            node = node.without_signing(str(error))  # noqa: PLW2901 - what is left of it
        nodes.append(node)
    for grant, left in plan.pruned:
        try:
            alone = replace(plan, nodes=(), pruned=((grant, left),))
            signed += _sign_alone(authority, alone, now)
        except OF_ALL:
            raise
        except HintedError as error:
            at = next(at for at, node in enumerate(nodes) if grant in _contradicting(node))
            nodes[at] = replace(
                nodes[at], refused=(*nodes[at].refused, f"{grant.subject}: {error}")
            )
            left = ()  # noqa: PLW2901 - it goes all the same
        pruned.append((grant, left))
    return signed, replace(plan, nodes=tuple(nodes), pruned=tuple(pruned))


def _contradicting(node: NodeDifference) -> list[Grant]:
    return [each.grant for each in node.contradictions]


def _sign_alone(
    authority: SigningAuthority, plan: PolicyPlan, now: int
) -> list[tuple[Draft, bytes]]:
    drafts = list(plan.drafts(authority.domain, now, lambda: secrets.token_bytes(ID_SIZE)))
    signed = authority.issue_grants(drafts, now, plan.policy.check_unchanged) if drafts else []
    return [(draft, data) for (draft, _), data in zip(drafts, signed, strict=True)]


def grant_outright(
    authority: SigningAuthority,
    policy: PolicyFile,
    names: Collection[str],
    now: int,
    *,
    renewed_until: int | None = None,
) -> list[tuple[Draft, bytes]]:
    """Sign what `policy` gives the nodes `names` outright and they do not have; revokes nothing.

    `renewed_until`: until when the master can renew grants; None: it cannot.

    Raises:
        PolicyRefused: one of several cannot get all, or a single one nothing; nothing is signed.
        ConfigurationError, StoreError: as `sign_planned`.
    """
    renews = renewed_until is not None
    moment = Moment(now, SKEW, renews=renews, renewed_until=renewed_until)
    plan = make_plan(authority.store, policy, PlanOptions(names), moment)
    if plan.refused and (len(plan.nodes) > 1 or not plan.signs):
        raise PolicyRefused(plan.refused[0], "see: rossec policy apply --dry-run")
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
    return authority.revoke_all(gone, _reason(plan), now)


def _reason(plan: PolicyPlan) -> str:
    return f"policy {plan.policy.policy.robot}"
