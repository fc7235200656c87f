"""`rossec explain`: whether a node may do something, by which rule, and what would change that."""

from pathlib import Path

import click

from ca.domains.aliases import is_alias, local_name
from ca.names import check_name
from grants.errors import PolicyRefused
from grants.model import Right
from grants.policy.mistakes import suggest
from grants.policy.model import Subject
from grants.policy.rules import RIGHTS
from grants.policy.shown import as_json as levels_json
from grants.policy.shown import lines as level_lines
from grants.policy.shown import shown
from grants.policy.trial import Trial
from rossec import files
from rossec.authority import foreign_nodes
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import layout_of, read_policy
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.message_output import flat
from rossec.cli.shared.message_text import fill, parse_message, stamp_now
from rossec.errors import ConfigurationError
from rossec.participant.message_types import MessageType, message_type
from rossec.terminal import note, say, say_json

_MAX_MESSAGE = 64 * 1024 * 1024
_NO_KEY = bytes(32)


@click.command()
@click.argument("node")
@click.argument("right")
@click.argument("name")
@click.option(
    "--message", "message_file", type=options.FILE,
    help="try it on this message: YAML as in rostopic (.yaml), or its serialized bytes",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@options.policy
@pass_environment
def explain(
    environment: Environment,
    node: str,
    right: str,
    name: str,
    message_file: Path | None,
    as_json: bool,
    policy_path: Path | None,
) -> None:
    """Show whether NODE may use RIGHT (subscribe, publish, call, ...) on NAME, and why."""
    read = read_policy(environment.home, policy_path)
    decider = read.decider
    asked = _right(right)
    subject = subject_of(environment, node)
    if subject.key == _NO_KEY and any(who.key for rule in read.policy.rules for who in rule.who):
        note(f"{node} is not enrolled here: rules that pin its key do not count")
    verdict = decider.decide(subject, asked, name)
    seen = shown(read.policy, verdict, layout_of) if asked is Right.SUBSCRIBE else {}
    tried: dict[str, object] = {}
    if message_file is not None:
        kind = read.policy.type_of(name)
        if kind is None:
            raise ConfigurationError(
                f"{read.path} does not say the type of {name}", "add it to types"
            )
        message = _message(message_file, message_type(kind))
        outcome = Trial(layout_of(kind), verdict)(message, now())
        sent = outcome.message
        tried = {"sent": sent is not None, "reason": outcome.reason,
                 "changed": changes(kind, message, sent) if sent is not None else []}  # fmt: skip
    if as_json:
        say_json({
            "decision": str(verdict.effect),
            "rules": [rule.id for rule in verdict.rules],
            "explanation": decider.explain(verdict),
            "sees": levels_json(seen),
            **({"message": tried} if tried else {}),
        })  # fmt: skip
        return
    headline, *explanation = decider.explain(verdict)
    for line in (headline, *(f"  {line}" for line in level_lines(seen)), *explanation):
        say(line)
    if tried:
        say("this message would be sent" if tried["sent"] else f"withheld: {tried['reason']}")
        for line in tried["changed"] if isinstance(tried["changed"], list) else []:
            say(f"  {line}")


def subject_of(environment: Environment, node: str) -> Subject:
    """The node with the key it is enrolled with; with no key where it is not."""
    name = check_name(local_name(node))
    if (environment.home / "ca" / "ca.pem").exists():
        store = AuthorityHome.at(environment.home).store()
        try:
            if is_alias(name):
                return Subject(name, foreign_nodes.holder(store, name, now()))
            name = store.identities.certified_name(node, now())
            rows = [row for row in store.identities.all() if row.name == name]
        finally:
            store.close()
        if rows:
            return Subject(name, rows[-1].thumbprint, rows[-1].wildcard)
    return Subject(name, _NO_KEY)


def changes(kind: str, before: bytes, after: bytes) -> list[str]:
    """The fields changed for the receiver, `field: before -> after`."""
    read = message_type(kind).deserialize
    shown = [flat(read(data)) for data in (before, after)]
    return [
        f"{path}: {_short(value)} -> {_short(shown[1].get(path, '(gone)'))}"
        for path, value in shown[0].items()
        if shown[1].get(path) != value
    ]


def _short(value: str) -> str:
    return value if len(value) <= 60 else f"{value[:57]}..."


def _right(label: str) -> Right:
    if label not in RIGHTS:
        raise PolicyRefused(f"unknown right {label!r}", suggest(label, RIGHTS))
    return RIGHTS[label]


def _message(file: Path, kind: MessageType) -> bytes:
    data = files.read(file, _MAX_MESSAGE)
    if file.suffix not in (".yaml", ".yml", ".json"):
        return data
    message = kind.create()
    fill(message, parse_message(data.decode(errors="replace")), stamp_now())
    return bytes(kind.serialize(message))
