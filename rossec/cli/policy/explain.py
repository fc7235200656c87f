"""`rossec explain`, `rossec privacy`: whether a node may do something and why; who sees which data."""

from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from ca.names import check_name, is_alias, local_name
from grants import document
from grants.errors import PolicyRefused
from grants.model import Grant, Permission, Right, format_time
from grants.policy import privacy as report
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Policy, Subject
from grants.policy.privacy import ReceiverAccess, Trial, level_lines, levels_json, shown
from grants.policy.rules import RIGHTS
from grants.policy.source import suggest
from grants.policy.wanted import gives_whole, held_lines, in_force, in_force_lines
from grants.request import grant_command
from rossec import files
from rossec.authority import domain_operations
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, place, read_policy
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.messages import fill, flat, parse_message, stamp_now
from rossec.clock import format_time as clock_format_time
from rossec.errors import ConfigurationError
from rossec.participant.host_types import layout_of
from rossec.participant.message_types import MessageType, message_type
from rossec.terminal import note, say

_MAX_MESSAGE = 64 * 1024 * 1024
_NO_KEY = bytes(32)


@click.command()
@click.argument("node")
@click.argument("right")
@click.argument("name")
@options.option(
    "--message message_file",
    "try it on this message: YAML as in rostopic (.yaml), or its serialized bytes",
    type=options.FILE,
)
@options.as_json
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
    if right not in RIGHTS:
        raise PolicyRefused(f"unknown right {right!r}", suggest(right, RIGHTS))
    asked = RIGHTS[right]
    subject = subject_of(environment, node)
    certified = _certified(environment)
    # Every key the name ever had here: a grant for an older one is in force until it ends.
    keys = {subject.key, *certified.get(subject.name, ())} - {_NO_KEY}
    held = _in_force(environment, keys, asked, name)
    if certified and policy_path is None and not place(environment.home, None).exists():
        if subject.name not in certified:
            note(f"nobody named {node} is enrolled here ({suggest(node, certified)})")
        in_force = [_as_json(each) for each in held]
        document = {"decision": "none", "rules": [], "explanation": [], "sees": {}, "in_force": in_force}
        options.say_result(as_json, document, _lines_of_grants(subject, asked, name, held))
        return
    read = read_policy(environment.home, policy_path)
    decider = read.decider
    # 1. What is not known of the node: whether there is one of that name, or its key.
    if not _is_known(read.policy, subject, certified):
        rules = read.policy.rules
        named = {who.node for rule in rules for who in rule.who if who.node and "*" not in who.node}
        close = suggest(subject.name, {*certified, *named})
        note(f"nobody named {node} is known: not enrolled here, and no rule names it ({close})")
    if subject.key == _NO_KEY and any(who.key for rule in read.policy.rules for who in rule.who):
        note(f"{node} is not enrolled here: rules that pin its key do not count")
    # 2. What the policy decides, what the node would see, and what grants give though it does not.
    verdict = decider.decide(subject, asked, name)
    seen = shown(read.policy, verdict, layout_of) if asked is Right.SUBSCRIBE else {}
    tried: dict[str, Any] = {}
    if message_file is not None:
        tried = _tried(read, verdict, message_file)
    document = {
        "decision": str(verdict.effect),
        "rules": [rule.id for rule in verdict.rules],
        "explanation": decider.explain(verdict),
        "sees": levels_json(seen),
        "in_force": [_as_json(each) for each in held],
        **({"message": tried} if tried else {}),
    }

    def lines() -> Iterator[str]:
        if not verdict and gives_whole(held, asked, name):
            yield f"IN FORCE: {verdict.subject.name} {asked.label} {name}, by a grant; the policy says"
        headline, *explanation = decider.explain(verdict)
        yield from (headline, *(f"  {line}" for line in level_lines(seen)), *explanation)
        yield from (f"  {line}" for line in in_force_lines(held, verdict))
        if tried:
            yield "this message would be sent" if tried["sent"] else f"withheld: {tried['reason']}"
            yield from (f"  {line}" for line in tried["changed"])

    options.say_result(as_json, document, lines())


def subject_of(environment: Environment, node: str) -> Subject:
    """The node with the key it is enrolled with; with no key where it is not."""
    name = check_name(local_name(node))
    if (environment.home / "ca" / "ca.pem").exists():
        with closing(AuthorityHome.at(environment.home).store()) as store:
            if is_alias(name):
                return Subject(name, domain_operations.holder(store, name, now()))
            name = store.identities.certified_name(node, now())
            rows = [row for row in store.identities.all() if row.name == name]
        if rows:
            return Subject(name, rows[-1].thumbprint, rows[-1].wildcard)
    return Subject(name, _NO_KEY)


def _certified(environment: Environment) -> dict[str, set[bytes]]:
    found: dict[str, set[bytes]] = {}
    if (environment.home / "ca" / "ca.pem").exists():
        with closing(AuthorityHome.at(environment.home).store()) as store:
            for row in store.identities.all():
                found.setdefault(row.name, set()).add(row.thumbprint)
    return found


def _in_force(environment: Environment, keys: Collection[bytes], right: Right, name: str) -> list[Grant]:
    if not keys or not (environment.home / "ca" / "ca.pem").exists():
        return []
    with closing(AuthorityHome.at(environment.home).store()) as store:
        grants = [document.peek(row.data) for row in store.grants()]
        revoked = store.revoked_entries()
    return in_force(grants, keys, right, name, now=now(), revoked=revoked)


def _lines_of_grants(subject: Subject, right: Right, name: str, held: list[Grant]) -> Iterator[str]:
    whole = gives_whole(held, right, name)
    yield f"{'IN FORCE' if whole else 'DENY'}: {subject.name} {right.label} {name}"
    for line in (*held_lines(held, right, name), "there is no policy, only grants signed by hand"):
        yield f"  {line}"
    if not whole:
        yield f"  {grant_command(subject.name, [(right, name)])} would change it"


def _as_json(grant: Grant) -> dict[str, object]:
    return {"grant": grant.id.hex(), "until": format_time(grant.expires)}


def _is_known(policy: Policy, subject: Subject, certified: Collection[str]) -> bool:
    # Whether the node is enrolled, of another domain, or meant by a rule that is not for all.
    if subject.name in certified or is_alias(subject.name):
        return True
    return any(
        not is_for_all(who.node) and who.matches(replace(subject, key=who.key or subject.key))
        for rule in policy.rules
        for who in rule.who
        if who.node is not None
    )


def is_for_all(node: str) -> bool:
    return node in ("/**", "**", "*")


def _tried(read: PolicyFile, verdict: Verdict, message_file: Path) -> dict[str, Any]:
    # What would become of a message.
    kind = read.policy.type_of(verdict.name)
    if kind is None:
        raise ConfigurationError(f"{read.path} does not say the type of {verdict.name}", "add it to types")
    message = _message(message_file, message_type(kind))
    outcome = Trial(layout_of(kind), verdict)(message, now())
    sent = outcome.message
    return {
        "sent": sent is not None,
        "reason": outcome.reason,
        "changed": changes(kind, message, sent) if sent is not None else [],
    }


def _message(file: Path, kind: MessageType) -> bytes:
    data = files.read(file, _MAX_MESSAGE)
    if file.suffix not in (".yaml", ".yml", ".json"):
        return data
    message = kind.create()
    fill(message, parse_message(data.decode(errors="replace")), stamp_now())
    return bytes(kind.serialize(message))


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


def show_privacy(
    environment: Environment,
    policy_path: Path | None,
    *,
    node: str | None,
    field: str | None,
    held: bool,
    html: Path | None,
    as_json: bool,
) -> None:
    read = read_policy(environment.home, policy_path)
    accesses = report.from_policy(read.decider)
    if held:
        told: Callable[[int], str] = clock_format_time
        if html is not None:
            from rossec.console.words import day  # noqa: PLC0415 - for a page alone

            told = day
        accesses = _held(AuthorityHome.at(environment.home), read.decider, told)
    if html is not None:
        wanted = partial(_is_wanted, node, field)
        try:
            from rossec.console.matrix import topics  # noqa: PLC0415 - an extra
            from rossec.console.pages.visibility import write  # noqa: PLC0415 - an extra
            from rossec.console.words import Names  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            raise ConfigurationError(
                f"a page needs the package {error.name}", "pip install 'rossec[console]', or leave out --html"
            ) from error
        found, policy = topics(accesses, layout_of, wanted, read.policy.vocabulary), read.policy
        page = write(found, policy.robot, now(), Names(dict(policy.titles)))
        files.replace(html, page.encode(), 0o644)
        say(f"written to {html}")
        return
    rows = [
        row
        for row in report.rows(accesses, layout_of, read.policy.vocabulary)
        if _is_wanted(node, field, row.receiver, row.field)
    ]
    options.say_result(as_json, report.as_json(rows), report.lines(rows))


def _held(home: AuthorityHome, decider: Decider, told: Callable[[int], str]) -> list[ReceiverAccess]:
    with closing(home.store()) as store:
        revoked = store.revoked_entries()
        grants = [document.peek(row.data) for row in store.grants() if row.id not in revoked]
    return [
        _access(grant, permission, decider, told)
        for grant in grants
        if grant.not_before <= now() < grant.expires
        for permission in grant.permissions
        if Right.SUBSCRIBE in permission.rights
    ]


def _access(
    grant: Grant, permission: Permission, decider: Decider, told: Callable[[int], str]
) -> ReceiverAccess:
    subject = Subject(check_name(grant.subject), grant.holder, grant.has_tail_patterns)
    verdict = decider.decide(subject, Right.SUBSCRIBE, permission.pattern)
    restriction = permission.restriction
    kind = decider.policy.type_of(permission.pattern)
    return ReceiverAccess(
        permission.pattern,
        kind if restriction is None or restriction.type is None else restriction.type,
        grant.subject,
        "; ".join(rule.why for rule in verdict.rules if rule.why and verdict),
        told(grant.expires),
        f"grant {grant.short_id}",
        () if restriction is None else (restriction,),
        getattr(restriction, "rate", None),
    )


def _is_wanted(node: str | None, field: str | None, receiver: str, path: str) -> bool:
    return node in (None, receiver) and (field is None or field in path)
