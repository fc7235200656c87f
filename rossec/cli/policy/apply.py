"""`rossec policy apply`: make the grants in force what the policy allows outright."""

import shlex
from pathlib import Path

import click

from ca.domains.aliases import is_alias
from grants.policy.lint import lint
from rossec.authority.policy_operations import require_complete
from rossec.authority.policy_plan import PolicyPlan
from rossec.authority.policyfile import PolicyFile, layout_of, read_policy
from rossec.authority.service import AuthorityService
from rossec.cli.policy import apply_report
from rossec.cli.policy.apply_report import count
from rossec.cli.shared import options
from rossec.cli.shared.busy import working
from rossec.cli.shared.context import confirm
from rossec.cli.shared.service import pass_service, remind_to_publish
from rossec.errors import NotDelivered, PolicyContradicted
from rossec.terminal import note, say, say_json


@click.command()
@options.policy
@click.option("--node", "names", multiple=True, metavar="NAME", help="only for this node")
@click.option("--dry-run", is_flag=True, help="only show the difference")
@click.option("--prune", is_flag=True, help="revoke grants made by hand against a denial, too")
@click.option("--renew", is_flag=True, help="sign anew what has less than a third of its time left")
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@click.option("--json", "as_json", is_flag=True, help="the difference as one line of JSON")
@pass_service
def apply(
    service: AuthorityService,
    policy_path: Path | None,
    names: tuple[str, ...],
    dry_run: bool,
    prune: bool,
    renew: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Put the policy in force: sign what it allows outright, revoke what it does not allow.

    Shows the difference to the grants in force (+ new, ~ narrower or wider, - no longer allowed),
    asks, signs and delivers what is new, then revokes the rest. Grants that say what the policy
    says are kept. Applying it twice changes nothing. Grants made by hand are left alone.

    What cannot be granted to one node is said, and keeps no other from its own.

    Exit codes: 0 in force, or shown with --dry-run; 1 refused, nothing was done; 2 wrong usage; 3
    signed here, but the master did not take it; 4 as 0, but grants made by hand allow what the
    policy denies; 6 as 0, but some of it cannot be granted to some nodes; 130 interrupted.
    """
    policy = read_policy(service.rossec_home, policy_path, signs=True)
    with working("comparing the policy with the grants in force", quiet=as_json):
        plan = service.plan_policy(policy, names or None, renew_due=renew, prune=prune)
    if as_json:
        say_json(apply_report.as_json(plan))
    else:
        for line in apply_report.lines(plan):
            say(line)
    _remark(policy, policy_path)
    if not dry_run:
        _carry_out(service, plan, yes=yes, as_json=as_json)
    require_complete(plan)
    _check_contradictions(plan)


def _remark(policy: PolicyFile, given: Path | None) -> None:
    """Say that lint finds leaks; it refuses nothing."""
    leaks = [item for item in lint(policy.policy, layout_of) if item.is_leak]
    if leaks:
        command = shlex.join(["rossec", "policy", "lint", *([str(given)] if given else [])])
        note(
            f"this policy may give away more than it says, {count(len(leaks), 'remark')}: {command}"
        )


def _carry_out(service: AuthorityService, plan: PolicyPlan, *, yes: bool, as_json: bool) -> None:
    if not plan.is_empty:
        confirm(f"{apply_report.summary(plan)}?", yes=yes)
        service.unlock()  # it may ask
        with working("signing and delivering", quiet=as_json):
            service.apply_policy(plan, note if as_json else say)
        if any(node.sign and is_alias(node.subject.name) for node in plan.nodes):
            say(f"grants for nodes of other domains are in {service.outgoing}: carry them there")
        if not plan.revoke:  # else the list was published
            remind_to_publish(service)
        return
    try:
        service.complete_policy()
    except NotDelivered as error:  # nothing was signed now, so nothing is undelivered for certain
        note(str(error))


def _check_contradictions(plan: PolicyPlan) -> None:
    """Return if no grant made by hand allows what the policy denies.

    Raises:
        PolicyContradicted: some do.
    """
    grants = {each.grant.id for each in plan.contradictions}
    if grants:
        allow = "grant made by hand allows" if len(grants) == 1 else "grants made by hand allow"
        raise PolicyContradicted(
            f"{len(grants)} {allow} what the policy denies",
            "revoke them with: rossec policy apply --prune; or: rossec grant revoke ID",
        )
