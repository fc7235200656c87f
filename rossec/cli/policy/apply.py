"""`rossec policy apply | learn | review`, `rossec privacy opt-out`: a policy grows and is put in force."""

import asyncio
import contextlib
import shlex
import time
from dataclasses import replace
from pathlib import Path

import click

from ca.names import check_pattern, is_alias
from grants import document
from grants.policy import learn as learning
from grants.policy.lint import lint
from grants.policy.rules import ID as BASICS
from grants.policy.rules import is_basics
from grants.policy.source import suggest
from grants.request import own_form
from rossec import files
from rossec.authority.grant_operations import require_complete, require_delivered
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, PolicyPlan, parse_policy, place, read_policy
from rossec.authority.service import AuthorityService
from rossec.cli.policy import check
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, confirm, now, pass_environment
from rossec.cli.shared.master import find_master, master_as
from rossec.cli.shared.service import deliver_grants, pass_service, publish_list, remind_to_publish
from rossec.errors import ConfigurationError, NotDelivered, PolicyContradicted
from rossec.home import NodeHome
from rossec.participant.host_types import layout_of
from rossec.ros.names import PRESENT_GRANTS
from rossec.terminal import note, record, say

_CHOICES = {"a": "allow", "c": "allow coarsely", "g": "allow beside it too", "d": "deny", "s": "skip"}


@click.command()
@options.option("--from-graph=NODE node", "as this node ask the running master")
@options.option("--from-log log", "from this denial log (rossec master --denial-log FILE)", type=options.FILE)
@options.option("--out", "write here instead of the policy", type=options.PATH)
@options.policy
@options.json_result(pass_environment)
def learn(
    environment: Environment, node: str | None, log: Path | None, out: Path | None, policy_path: Path | None
) -> None:
    """Add rules for what runs and no rule decides: exact names, marked for review.

    NODE needs a grant with the right graph. Callers of services and readers of parameters do not
    show in the graph, only in a denial log.
    """
    if node is None and log is None:
        raise ConfigurationError("nothing to learn from", "add --from-graph or --from-log")
    seen = _read_log(log) if log is not None else []
    if node is not None:
        observed = asyncio.run(_observe_graph(environment, node))
        if (environment.home / "ca" / "ca.pem").exists():
            # An anonymous node has another name at each start: a rule is for the one it is certified for.
            with contextlib.closing(AuthorityHome.at(environment.home).store()) as store:
                certified, at = store.identities.certified_name, now()
                named = (
                    replace(each, node=certified(each.node, at), name=own_form(each.node, each.name))
                    for each in observed
                )
                observed = list(dict.fromkeys(named))
        seen += observed
    read = _existing(place(environment.home, policy_path))
    text, rules = learning.learn(read.text, read.decider, seen, _day())
    if out is None:
        read.replace(text)
    else:
        # What was learned must be a policy itself, before it takes the place of one.
        parse_policy(text, str(out))
        files.replace(out, text.encode(), 0o644, keep=True)
    record(rules=[rule.id for rule in rules], file=str(out or read.path))
    if learning.needs_basics(seen) and not any(map(is_basics, read.policy.rules)):
        note("what every ROS program needs was left out: add basics: true to the policy")
    for rule in rules:
        say(f"learned {rule.id}: {_rights(rule)}")
    total = len(rules) + _count_own(read)
    say(
        f"{check.count(len(rules), 'new rule')}, {total} in {out or read.path};"
        " next: rossec policy review --from-log FILE"
    )


def _read_log(path: Path) -> list[learning.Observation]:
    with path.open(encoding="utf-8", errors="replace") as file:
        return learning.from_log(files.lines(file, learning.MAX_LINE + 2))


async def _observe_graph(environment: Environment, node: str) -> list[learning.Observation]:
    home = NodeHome.of(environment.home, node)
    async with master_as(environment, home, await find_master(environment, home)) as client:
        await client.ask(PRESENT_GRANTS, home.name, home.grants())
        state = await client.ask("getSystemState", home.name)
        types = await client.ask("getTopicTypes", home.name)
    return [item for item in learning.from_graph(state, types) if item.node != home.name]


def _existing(path: Path) -> PolicyFile:
    # The policy, or a new one that gives basics alone; not written yet.
    if path.exists():
        return PolicyFile.read(path)
    if not path.parent.is_dir():
        raise ConfigurationError(f"there is no {path.parent}", "give --policy FILE")
    text = learning.beginning("robot")
    return PolicyFile(path, text, parse_policy(text, str(path)))


def _day() -> str:
    return time.strftime("%Y-%m-%d", time.gmtime(now()))


def _rights(rule: learning.NewRule) -> str:
    return "; ".join(f"{label} {', '.join(names)}" for label, names in rule.rights.items())


def _count_own(read: PolicyFile) -> int:
    return sum(rule.id != BASICS for rule in read.policy.rules)


@click.command()
@options.option("--from-log log", "what to go through", type=options.FILE, required=True)
@options.policy
@pass_environment
def review(environment: Environment, log: Path, policy_path: Path | None) -> None:
    """Go through a denial log, and answer for each line no rule decides."""
    read = _existing(place(environment.home, policy_path))
    before = _count_own(read)
    for seen in _read_log(log):
        item = learning.learnable(seen)
        if item is not None and learning.learn(read.text, read.decider, [item], _day())[1]:
            say(f"{item.node} wants to {item.right.label} {item.name}")
            question = ", ".join(f"[{letter}] {words}" for letter, words in _CHOICES.items())
            answer = click.prompt(question, type=click.Choice(list(_CHOICES)), default="s", err=True)
            if answer != "s":
                read = read.replace(learning.add_rules(read.text, [_rule_of(read, item, answer)]))
    total = _count_own(read)
    say(f"{check.count(total - before, 'new rule')}, {total} in {read.path}")


def _rule_of(read: PolicyFile, item: learning.Observation, answer: str) -> learning.NewRule:
    name = item.name.rsplit("/", 1)[0] + "/*" if answer == "g" else item.name
    chosen = None
    if answer == "c":
        chosen = click.prompt("through which filter of the policy?", err=True)
        if chosen not in read.policy.filters:
            hint = suggest(chosen, read.policy.filters)
            raise ConfigurationError(f"no filter {chosen!r} in {read.path}", hint)
    effect = "deny" if answer == "d" else "allow"
    prefix = f"{'no' if effect == 'deny' else 'reviewed'}-{item.node[1:].replace('/', '-')}"
    return learning.NewRule(
        learning.free_id((rule.id for rule in read.policy.rules), prefix[:70]),
        f"reviewed {_day()}",
        item.node,
        effect,
        {item.right.label: [name]},
        {item.name: item.type} if item.type not in ("", "*") else {},
        chosen,
    )


@click.command()
@options.policy
@options.option("--node=NAME names", "only for this node", multiple=True)
@options.flag("--dry-run", "only show the difference")
@options.flag("--prune", "revoke grants made by hand against a denial, too")
@options.flag("--renew", "sign anew what has less than a third of its time left")
@options.master_uri
@options.yes
@options.flag("--json as_json", "the difference as one line of JSON")
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
    with options.working("comparing the policy with the grants in force", quiet=as_json):
        plan = service.policy.plan(policy, names or None, renew_due=renew, prune=prune)
    options.say_result(as_json, check.as_json(plan), check.lines(plan))
    leaks = [item for item in lint(policy.policy, layout_of) if item.is_leak]
    if leaks:
        command = shlex.join(["rossec", "policy", "lint", *([str(policy_path)] if policy_path else [])])
        note(f"this policy may give away more than it says, {check.count(len(leaks), 'remark')}: {command}")
    if not dry_run:
        _carry_out(service, plan, yes=yes, as_json=as_json)
    require_complete(plan)
    # By hand stays (decision 0026): an operator knows more than the file. But a denial is a promise.
    grants = {each.grant.id for each in plan.contradictions}
    if grants:
        allow = "grant made by hand allows" if len(grants) == 1 else "grants made by hand allow"
        raise PolicyContradicted(
            f"{len(grants)} {allow} what the policy denies",
            "revoke them with: rossec policy apply --prune; or: rossec grant revoke ID",
        )


def _carry_out(service: AuthorityService, plan: PolicyPlan, *, yes: bool, as_json: bool) -> None:
    if not plan.is_empty:
        confirm(f"{check.summary(plan)}?", yes=yes)
        service.unlock()  # it may ask
        with options.working("signing and delivering", quiet=as_json):
            service.policy.apply(plan, note if as_json else say)
        if any(node.sign and is_alias(node.subject.name) for node in plan.nodes):
            say(f"grants for nodes of other domains are in {service.grants.outgoing}: carry them there")
        if not plan.revoke:  # else the list was published
            remind_to_publish(service)
        return
    try:
        service.policy.complete()
    except NotDelivered as error:  # nothing was signed now, so nothing is undelivered for certain
        note(str(error))


@click.command("opt-out")
@click.argument("name")
@options.flag("--node is_node", "NAME is a node, enrolled or not")
@options.master_uri
@options.policy
@options.json_result(pass_service)
def opt_out(service: AuthorityService, name: str, is_node: bool, policy_path: Path | None) -> None:
    """Show the topic NAME to no node; or, when NAME is a node, show that node no topic.

    Adds a denial to the policy and revokes what was granted. Running connections end at once.
    What else the revoked grants allowed is granted anew.
    """
    check_pattern(name)
    policy = read_policy(service.rossec_home, policy_path)
    opted_out = service.policy.opt_out(policy, name, is_node=is_node)
    record(rule=opted_out.rule, file=str(opted_out.policy.path))
    # One anonymous node of several is its identity: the others would go on (attack `opt-out`).
    if opted_out.name != name:
        say(f"{name} is one of the anonymous nodes of {opted_out.name}, which are one identity:")
        say("all of them are opted out")
    say(f"rule {opted_out.rule} in {opted_out.policy.path} denies it from now on")
    # The denial stands in the policy first: what is revoked next is not granted anew by it.
    withdrawn = service.policy.revoke_opted_out(opted_out)
    for grant, _ in withdrawn:
        say(f"revoked grant {grant.id.hex()} of {grant.subject}")
    record(revoked_grants=[grant.id.hex() for grant, _ in withdrawn])
    reissued = [data for _, data in withdrawn if data is not None]
    for data in reissued:
        say(f"its other rights are grant {document.grant_id(data).hex()}")
    refused = deliver_grants(service, reissued)
    if withdrawn:
        publish_list(service)
    require_delivered(refused)
