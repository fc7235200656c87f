"""`rossec explain`: whether a node may do something, by which rule, and what would change that."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import click

from ca.domains.aliases import is_alias, local_name
from ca.names import check_name
from grants import document
from grants.errors import PolicyRefused
from grants.missing_rights import grant_command
from grants.model import Grant, Right
from grants.policy.decision import Verdict
from grants.policy.in_force import gives_whole, held_lines, in_force
from grants.policy.in_force import lines as in_force_lines
from grants.policy.mistakes import suggest
from grants.policy.model import Policy, Subject
from grants.policy.rules import RIGHTS
from grants.policy.shown import as_json as levels_json
from grants.policy.shown import lines as level_lines
from grants.policy.shown import shown
from grants.policy.trial import Trial
from grants.validity import format_time
from rossec import files
from rossec.authority import foreign_nodes
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, layout_of, place, read_policy
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
    """Show whether NODE may use RIGHT (subscribe, publish, call, ...) on NAME, and why.

    ALLOW, PROMPT or DENY is what the policy says, IN FORCE what grants give though it does not. A
    grant that was signed by hand, or before the policy was changed, holds until it ends or is
    revoked, whatever the policy says.
    """
    asked = _right(right)
    subject = subject_of(environment, node)
    certified = _certified(environment)
    keys = {subject.key, *certified.get(subject.name, ())} - {_NO_KEY}
    held = _in_force(environment, keys, asked, name)
    if certified and policy_path is None and not place(environment.home, None).exists():
        _without_policy(node, subject, asked, name, held, certified, as_json=as_json)
        return
    read = read_policy(environment.home, policy_path)
    decider = read.decider
    _note_unknown(node, subject, read.policy, certified)
    verdict = decider.decide(subject, asked, name)
    seen = shown(read.policy, verdict, layout_of) if asked is Right.SUBSCRIBE else {}
    tried: dict[str, object] = {}
    if message_file is not None:
        tried = _tried(read, verdict, message_file)
    if as_json:
        say_json({
            "decision": str(verdict.effect),
            "rules": [rule.id for rule in verdict.rules],
            "explanation": decider.explain(verdict),
            "sees": levels_json(seen),
            "in_force": [_as_json(each) for each in held],
            **({"message": tried} if tried else {}),
        })  # fmt: skip
        return
    if not verdict and gives_whole(held, asked, name):
        say(f"IN FORCE: {verdict.subject.name} {asked.label} {name}, by a grant; the policy says")
    headline, *explanation = decider.explain(verdict)
    for line in (headline, *(f"  {line}" for line in level_lines(seen)), *explanation):
        say(line)
    for line in in_force_lines(held, verdict):
        say(f"  {line}")
    if tried:
        say("this message would be sent" if tried["sent"] else f"withheld: {tried['reason']}")
        for line in tried["changed"] if isinstance(tried["changed"], list) else []:
            say(f"  {line}")


def _tried(read: PolicyFile, verdict: Verdict, message_file: Path) -> dict[str, object]:
    """What would become of a message."""
    kind = read.policy.type_of(verdict.name)
    if kind is None:
        raise ConfigurationError(
            f"{read.path} does not say the type of {verdict.name}", "add it to types"
        )
    message = _message(message_file, message_type(kind))
    outcome = Trial(layout_of(kind), verdict)(message, now())
    sent = outcome.message
    return {"sent": sent is not None, "reason": outcome.reason,
            "changed": changes(kind, message, sent) if sent is not None else []}  # fmt: skip


def _without_policy(
    node: str, subject: Subject, right: Right, name: str, held: list[Grant],
    certified: Collection[str], *, as_json: bool,
) -> None:  # fmt: skip
    """Grants that were signed by hand are all there is."""
    if subject.name not in certified:
        note(f"nobody named {node} is enrolled here ({suggest(node, certified)})")
    lines = held_lines(held, right, name)
    if as_json:
        say_json({"decision": "none", "rules": [], "explanation": [], "sees": {},
                  "in_force": [_as_json(each) for each in held]})  # fmt: skip
        return
    whole = gives_whole(held, right, name)
    say(f"{'IN FORCE' if whole else 'DENY'}: {subject.name} {right.label} {name}")
    for line in (*lines, "there is no policy, only grants signed by hand"):
        say(f"  {line}")
    if not whole:
        say(f"  {grant_command(subject.name, [(right, name)])} would change it")


def _as_json(grant: Grant) -> dict[str, object]:
    return {"grant": grant.id.hex(), "until": format_time(grant.expires)}


def _certified(environment: Environment) -> dict[str, set[bytes]]:
    """The keys that are certified here, by the name of their node."""
    found: dict[str, set[bytes]] = {}
    if (environment.home / "ca" / "ca.pem").exists():
        store = AuthorityHome.at(environment.home).store()
        try:
            for row in store.identities.all():
                found.setdefault(row.name, set()).add(row.thumbprint)
        finally:
            store.close()
    return found


def _note_unknown(node: str, subject: Subject, policy: Policy, certified: Collection[str]) -> None:
    """Say what is not known of the node: whether there is one of that name, or its key."""
    if not _is_known(policy, subject, certified):
        close = suggest(subject.name, {*certified, *_named(policy)})
        note(f"nobody named {node} is known: not enrolled here, and no rule names it ({close})")
    if subject.key == _NO_KEY and any(who.key for rule in policy.rules for who in rule.who):
        note(f"{node} is not enrolled here: rules that pin its key do not count")


def _is_known(policy: Policy, subject: Subject, certified: Collection[str]) -> bool:
    """Whether the node is enrolled, of another domain, or meant by a rule that is not for all."""
    if subject.name in certified or is_alias(subject.name):
        return True
    return any(
        not is_for_all(who.node) and who.matches(replace(subject, key=who.key or subject.key))
        for rule in policy.rules
        for who in rule.who
        if who.node is not None
    )


def is_for_all(node: str) -> bool:
    """Whether a pattern of nodes means nobody in particular."""
    return node in ("/**", "**", "*")


def _named(policy: Policy) -> set[str]:
    nodes = (who.node for rule in policy.rules for who in rule.who)
    return {node for node in nodes if node is not None and "*" not in node}


def _in_force(
    environment: Environment, keys: Collection[bytes], right: Right, name: str
) -> list[Grant]:
    """The grants that the authority here signed, for every key that is certified for the node."""
    if not keys or not (environment.home / "ca" / "ca.pem").exists():
        return []
    store = AuthorityHome.at(environment.home).store()
    try:
        grants = [document.peek(row.data) for row in store.grants()]
        revoked = store.revoked_entries()
    finally:
        store.close()
    return in_force(grants, keys, right, name, now=now(), revoked=revoked)


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
