"""`rossec namespace serve | check`: names for nodes that ask, and rules tried before they are used."""

import asyncio
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Final

import click

from ca.names import covers
from grants.decision import Reach
from grants.errors import GrantError
from grants.model import Grant, Right
from grants.policy.decision import Decider
from grants.policy.model import Effect, Policy, Subject
from grants.token import peek
from rossec import files
from rossec.authority.policyfile import PolicyFile
from rossec.cli.shared import options, rules
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as, read_token
from rossec.cli.shared.options import FILE, OLD_FOLDER, flag, option
from rossec.errors import ConfigurationError, ProposedNameRefused
from rossec.host.runner import stop_on_signals, until_stopped
from rossec.namespace import topic_names
from rossec.namespace.topic_names import CALLS, CHILDREN, DEADLINE, SECONDS, SERVICE, TopicNames
from rossec.naming import MAX_INPUT, MetadataReport, NameKind, RuleRunner
from rossec.naming.examine import examine
from rossec.terminal import note, printable, say, say_json

RIGHTS: Final = {
    NameKind.TOPIC: Right.PUBLISH | Right.SUBSCRIBE,
    NameKind.SERVICE: Right.PROVIDE | Right.CALL,
}
SUFFIX: Final = "*.grant"
_NO_KEY: Final = bytes(32)
METADATA_SUFFIX: Final = "*.xml"
MAX_FILES: Final = 1024


@click.command()
@click.argument("rules", type=FILE)
@option("--meta=DIR directory", f"metadata of nodes, files {METADATA_SUFFIX}", required=True, type=OLD_FOLDER)
@option("--policy=FILE policy_path", "report names on which this policy gives their node nothing", type=FILE)
@option(
    "--grants=DIR grants_path",
    "report names on which no grant in DIR (files *.grant) gives their node anything",
    type=OLD_FOLDER,
)
@options.as_json
def check(
    rules: Path, directory: Path, policy_path: Path | None, grants_path: Path | None, as_json: bool
) -> None:
    """Try RULES on the metadata of many nodes: which names are wrong, and why.

    Reported are, each with the file and line of the metadata: names that are none or reserved, one
    name for two things, names that change with the order of the metadata, and with --policy or
    --grants names that no rule or grant covers.
    """
    found = sorted(directory.glob(METADATA_SUFFIX))
    if not found:
        raise ConfigurationError(
            f"there are no metadata in {directory}", f"it is a folder with files {METADATA_SUFFIX}"
        )
    if len(found) > MAX_FILES:
        raise ConfigurationError(f"{len(found)} files in {directory} where {MAX_FILES} are allowed")
    documents = [(str(path), files.read(path, MAX_INPUT)) for path in found]
    covered = None
    if policy_path is not None or grants_path is not None:
        held = [] if grants_path is None else read_grants(grants_path)
        covered = Coverage(held, None if policy_path is None else PolicyFile.read(policy_path).policy)

    async def examined() -> MetadataReport:
        async with RuleRunner(files.read(rules, MAX_INPUT)) as runner:
            return await examine(runner, documents, covered)

    report = asyncio.run(examined())
    if as_json:
        names = [
            {"kind": kind.value, "name": name, **asdict(place)}
            for (kind, name), places in sorted(report.names.items())
            for place in places
        ]
        say_json({"names": names, "findings": [asdict(each) for each in report.findings]})
    else:
        for finding in report.findings:
            say(printable(str(finding)))
        count = sum(map(len, report.names.values()))
        say(f"{count} names, {len(report.findings)} findings")
    if covered is None:
        note("names were not compared with rights: give --policy or --grants")
    if report.findings:
        raise ProposedNameRefused(
            f"{len(report.findings)} findings with the rules {rules}",
            "correct the rules or the metadata, and check again",
        )


def read_grants(directory: Path) -> list[Grant]:
    found = []
    for path in sorted(directory.glob(SUFFIX)):
        try:
            found.append(peek(read_token(path)))
        except GrantError as error:
            raise ConfigurationError(f"{path} is not a grant: {error}", error.hint) from None
    if not found:
        raise ConfigurationError(f"there are no grants in {directory}", f"it is a folder with files {SUFFIX}")
    return found


class Coverage:
    """Grants of any nodes and a policy, asked together: what either of them gives is covered.

    Grants are not verified: this is advice for who writes rules, and decides nothing. A rule that
    pins a key counts as if the node had it, since its key is not known before it is enrolled.
    """

    def __init__(self, grants: Iterable[Grant], policy: Policy | None) -> None:
        self._grants = tuple(grants)
        self._decider = None if policy is None else Decider(policy)
        rules = () if policy is None else policy.rules
        pinned = {who.key for rule in rules for who in rule.who if who.key is not None}
        self._keys = (_NO_KEY, *sorted(pinned))

    def __call__(self, node: str, kind: NameKind, name: str) -> bool:
        held = [grant for grant in self._grants if covers(grant.subject, node, wildcard=True)]
        covered = bool(held) if kind is NameKind.NODE else Reach.of(held).covers_any(RIGHTS[kind], name)
        if covered or self._decider is None:
            return covered
        subjects = [Subject(node, key) for key in self._keys]
        if kind is NameKind.NODE:
            return any(self._decider.rules_of(subject) for subject in subjects)
        verdicts = (self._decider.decide(who, right, name) for who in subjects for right in RIGHTS[kind])
        return any(verdict.effect is not Effect.DENY for verdict in verdicts)


@click.command()
@option("--as=NAME name", "identity to use", default="/namespace", show_default=True)
@rules.option
@flag("--json as_json", "say that it runs as a line of JSON")
@pass_environment
def serve(environment: Environment, name: str, rules_path: Path | None, *, as_json: bool) -> None:
    """Answer nodes that ask which name a topic or service of theirs gets. Ends with Ctrl-C.

    Provides the service /get_topic_name, for nodes that may call it. It answers only: a name is
    worth nothing to a node that has no grant for it.
    """
    asyncio.run(_serve(environment, name, rules.read_rules(rules_path), as_json=as_json))


async def _serve(environment: Environment, name: str, sheet: bytes, *, as_json: bool) -> None:
    stop = stop_on_signals()
    async with (
        RuleRunner(sheet, children=CHILDREN, seconds=SECONDS) as runner,
        node_as(environment, name) as node,
    ):
        names = TopicNames(runner, node.params.get)
        await node.services.provide(
            SERVICE, topic_names.service_type(), names.answer, concurrency=CALLS, deadline=DEADLINE
        )
        say_json({"ready": node.name}) if as_json else say(f"{node.name} provides {SERVICE}")
        await until_stopped(stop, environment.variables, node.wait_ended())
