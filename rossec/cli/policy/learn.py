"""`rossec policy learn | review`: rules made from what runs."""

import asyncio
import contextlib
import time
from dataclasses import replace
from pathlib import Path

import click

from grants.basics import own_form
from grants.policy.basics import ID as BASICS
from grants.policy.basics import is_basics
from grants.policy.beginning import beginning
from grants.policy.editing import NewRule, add_rules, free_id
from grants.policy.learn import (
    MAX_LINE,
    Observation,
    from_graph,
    from_log,
    learnable,
    needs_basics,
)
from grants.policy.learn import learn as learn_from
from grants.policy.mistakes import suggest
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, parse_policy, place
from rossec.cli.policy.apply_report import count
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import find_master, master_as
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.ros.names import PRESENT_GRANTS
from rossec.terminal import note, record, say

_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


@click.command()
@click.option("--from-graph", "node", metavar="NODE", help="as this node ask the running master")
@click.option(
    "--from-log", "log", type=_FILE, help="from this denial log (rossec master --complaints FILE)"
)
@click.option("--out", type=click.Path(path_type=Path), help="write here instead of the policy")
@options.policy
@json_result()
@pass_environment
def learn(
    environment: Environment,
    node: str | None,
    log: Path | None,
    out: Path | None,
    policy_path: Path | None,
) -> None:
    """Add rules for what runs and no rule decides: exact names, marked for review.

    NODE needs a grant with the right graph. Callers of services and readers of parameters do not
    show in the graph, only in a denial log.
    """
    if node is None and log is None:
        raise ConfigurationError("nothing to learn from", "add --from-graph or --from-log")
    seen = _read_log(log) if log is not None else []
    if node is not None:
        seen += _with_certified_names(environment, asyncio.run(_observe_graph(environment, node)))
    read = _existing(place(environment.home, policy_path))
    text, rules = learn_from(read.text, read.decider, seen, _day())
    if out is None:
        read.replace(text)
    else:
        parse_policy(text, str(out))
        files.replace(out, text.encode(), 0o644, keep=True)
    record(rules=[rule.id for rule in rules], file=str(out or read.path))
    if needs_basics(seen) and not any(map(is_basics, read.policy.rules)):
        note("what every ROS program needs was left out: add basics: true to the policy")
    for rule in rules:
        say(f"learned {rule.id}: {_rights(rule)}")
    total = len(rules) + _count_own(read)
    say(
        f"{count(len(rules), 'new rule')}, {total} in {out or read.path};"
        " next: rossec policy review --from-log FILE"
    )


@click.command()
@click.option("--from-log", "log", type=_FILE, required=True, help="what to go through")
@options.policy
@pass_environment
def review(environment: Environment, log: Path, policy_path: Path | None) -> None:
    """Go through a denial log, and answer for each line no rule decides."""
    read = _existing(place(environment.home, policy_path))
    before = _count_own(read)
    for seen in _read_log(log):
        item = learnable(seen)
        if item is not None and _undecided(read, item):
            read = _ask_about(read, item)
    total = _count_own(read)
    say(f"{count(total - before, 'new rule')}, {total} in {read.path}")


def _count_own(read: PolicyFile) -> int:
    """The number of rules that stand in the file: that of `basics` is one word there."""
    return sum(rule.id != BASICS for rule in read.policy.rules)


def _existing(path: Path) -> PolicyFile:
    """The policy, or a new one that gives basics alone; not written yet."""
    if path.exists():
        return PolicyFile.read(path)
    if not path.parent.is_dir():
        raise ConfigurationError(f"there is no {path.parent}", "give --policy FILE")
    text = beginning("robot")
    return PolicyFile(path, text, parse_policy(text, str(path)))


def _read_log(path: Path) -> list[Observation]:
    with path.open(encoding="utf-8", errors="replace") as file:
        return from_log(files.lines(file, MAX_LINE + 2))


async def _observe_graph(environment: Environment, node: str) -> list[Observation]:
    """The graph, as `node` may see it."""
    home = NodeHome.of(environment.home, node)
    async with master_as(environment, home, await find_master(environment, home)) as client:
        await client.ask(PRESENT_GRANTS, home.name, home.grants())
        state = await client.ask("getSystemState", home.name)
        types = await client.ask("getTopicTypes", home.name)
    return [item for item in from_graph(state, types) if item.node != home.name]


def _with_certified_names(environment: Environment, seen: list[Observation]) -> list[Observation]:
    """The observations under the names in certificates, where these are known."""
    if not (environment.home / "ca" / "ca.pem").exists():
        return seen
    with contextlib.closing(AuthorityHome.at(environment.home).store()) as store:
        named = (
            replace(
                item,
                node=store.identities.certified_name(item.node, now()),
                name=own_form(item.node, item.name),
            )
            for item in seen
        )
        return list(dict.fromkeys(named))


def _undecided(read: PolicyFile, item: Observation) -> bool:
    _, rules = learn_from(read.text, read.decider, [item], _day())
    return bool(rules)


_CHOICES = {
    "a": "allow",
    "c": "allow coarsely",
    "g": "allow beside it too",
    "d": "deny",
    "s": "skip",
}


def _ask_about(read: PolicyFile, item: Observation) -> PolicyFile:
    say(f"{item.node} wants to {item.right.label} {item.name}")
    question = ", ".join(f"[{letter}] {words}" for letter, words in _CHOICES.items())
    answer = click.prompt(question, type=click.Choice(list(_CHOICES)), default="s", err=True)
    if answer == "s":
        return read
    rule = _rule_of(read, item, answer)
    return read.replace(add_rules(read.text, [rule]))


def _rule_of(read: PolicyFile, item: Observation, answer: str) -> NewRule:
    name = item.name.rsplit("/", 1)[0] + "/*" if answer == "g" else item.name
    chosen = _prompt_for_filter(read) if answer == "c" else None
    effect = "deny" if answer == "d" else "allow"
    prefix = f"{'no' if effect == 'deny' else 'reviewed'}-{item.node[1:].replace('/', '-')}"
    return NewRule(
        free_id((rule.id for rule in read.policy.rules), prefix[:70]),
        f"reviewed {_day()}",
        item.node,
        effect,
        {item.right.label: [name]},
        {item.name: item.type} if item.type not in ("", "*") else {},
        chosen,
    )


def _prompt_for_filter(read: PolicyFile) -> str:
    name: str = click.prompt("through which filter of the policy?", err=True)
    if name not in read.policy.filters:
        hint = suggest(name, read.policy.filters)
        raise ConfigurationError(f"no filter {name!r} in {read.path}", hint)
    return name


def _rights(rule: NewRule) -> str:
    return "; ".join(f"{label} {', '.join(names)}" for label, names in rule.rights.items())


def _day() -> str:
    return time.strftime("%Y-%m-%d", time.gmtime(now()))
