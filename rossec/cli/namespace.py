"""`rossec namespace`: one name by rules, those of a launch file, names for nodes that ask; rules tried.

A launch file is written beside OUT with those it includes from its own directory. Only `$(dirname)/FILE`
is followed: a file of another directory belongs to somebody else, and what `$(find package)` or an
argument give is known to roslaunch alone. What is not followed is said (`notes`), since metadata in there
would have no effect. No file is overwritten, and nothing is written before everything has its names.
"""

import asyncio
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

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
from rossec.cli.shared.options import FILE, NEW_FILE, OLD_FOLDER, flag, json_result, option
from rossec.errors import ConfigurationError, MetadataRefused, ProposedNameRefused, RossecError
from rossec.host.runner import stop_on_signals, until_stopped
from rossec.namespace import launch_file, topic_names
from rossec.namespace.topic_names import CALLS, CHILDREN, DEADLINE, SECONDS, SERVICE, TopicNames
from rossec.naming import MAX_INPUT, MetadataReport, NameKind, RuleRunner, rule_runner
from rossec.naming.examine import examine
from rossec.terminal import note, printable, record, say, say_block, say_json

MAX_FILES: Final = 32
_BESIDE: Final = re.compile(r"\$\(dirname\)/([A-Za-z0-9_.-]+)")


RIGHTS: Final = {
    NameKind.TOPIC: Right.PUBLISH | Right.SUBSCRIBE,
    NameKind.SERVICE: Right.PROVIDE | Right.CALL,
}
SUFFIX: Final = "*.grant"
_NO_KEY: Final = bytes(32)
METADATA_SUFFIX: Final = "*.xml"
MAX_METADATA_FILES: Final = 1024


@click.command("launch")
@click.argument("source", metavar="IN.launch", type=FILE)
@option("--out=OUT", "the new file; one that exists is not overwritten", type=NEW_FILE, required=True)
@options.rules
@json_result()
def launch(source: Path, out: Path, rules_path: Path | None) -> None:
    """Write the launch file IN.launch again, with names that rules give in place of metadata.

    Nodes get a namespace, their topics and services are remapped; everything else stays as it is.
    Included files of the same directory (`$(dirname)/...`) are written beside OUT. Then start it:
    rossec run -- roslaunch OUT
    """
    found = asyncio.run(_named(source, out, rules.read_rules(rules_path)))
    found.write()
    for node in found.nodes:
        note(printable(node.name))
        for entry in node.entries:
            note(printable(f"  {entry.kind} {entry.source} is {entry.name}"))
    for text in found.notes:
        note(printable(text))
    if not found.nodes:
        note(f"{source} has no node with metadata")
    record(files=[str(path) for path in found.written], nodes=[each.name for each in found.nodes])
    for path in found.written:
        say(printable(str(path)))


@dataclass
class LaunchFiles:
    written: dict[Path, bytes] = field(default_factory=dict)
    nodes: list[launch_file.NamedNode] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def write(self) -> None:
        for path in self.written:
            if path.exists() or path.is_symlink():
                raise ConfigurationError(
                    f"{path} exists and is not overwritten", "remove it, or name a new file: --out"
                )
        # All or none: a launch file whose include is missing would start half a robot.
        with ExitStack() as undo:
            for path, data in self.written.items():
                # a launch file is for every user of the host, as the source is
                files.create(path, data, 0o644)
                undo.callback(path.unlink, missing_ok=True)
            undo.pop_all()


async def _named(source: Path, out: Path, sheet: bytes) -> LaunchFiles:
    async with RuleRunner(sheet) as runner:
        loop = asyncio.get_running_loop()

        def name_of(metadata: bytes, queries: Sequence[launch_file.Query]) -> list[str]:
            # The scanner runs in a thread: it asks the loop, which talks to the confined process.
            asked = runner.names(metadata, queries)
            found = list[str]()
            for result in asyncio.run_coroutine_threadsafe(asked, loop).result():
                if isinstance(result, RossecError):
                    raise result
                found.append(result)
            return found

        return await asyncio.to_thread(read, source, out, name_of)


def read(source: Path, out: Path, name_of: launch_file.NameOf) -> LaunchFiles:
    """The transformed files for `source`, which is to be written to `out`."""
    reader = _Reader(source.absolute().parent, out, name_of)
    reader.add(source, out)
    found = reader.found
    twice = Counter(node.name for node in found.nodes)
    for name in (name for name, count in twice.items() if count > 1):
        raise MetadataRefused(f"the rules name {twice[name]} nodes {name}", "see the files' lines")
    counts = Counter(name for node in found.nodes for name in {e.name for e in node.entries})
    found.notes += [
        f"{count} nodes get the name {name}: do they mean the same topic?"
        for name, count in counts.items()
        if count > 1
    ]
    return found


class _Reader:
    def __init__(self, directory: Path, out: Path, name_of: launch_file.NameOf) -> None:
        self.found = LaunchFiles()
        self._directory = directory
        self._out = out
        self._name_of = name_of
        self._targets: dict[Path, Path] = {}

    def add(self, source: Path, target: Path) -> None:
        if len(self._targets) == MAX_FILES:
            raise MetadataRefused(f"more than {MAX_FILES} launch files")
        if target in self._targets.values():
            raise ConfigurationError(f"two files would become {target}", "name another --out")
        self._targets[source.absolute()] = target
        try:
            data = files.read(source, MAX_INPUT)
            launch = launch_file.scan(data)
            nodes = launch_file.named(launch, self._name_of)
        except RossecError as error:
            raise type(error)(f"{source}: {error}", error.hint) from error
        self.found.nodes += nodes
        self._check_directory(source, target, data, launch)
        changes = launch_file.edits(data, launch, nodes)
        for include in launch.includes:
            changes += self._include(source, include)
        self.found.written[target] = launch_file.apply(data, changes)

    def _include(self, source: Path, include: launch_file.Include) -> list[launch_file.Edit]:
        match = _BESIDE.fullmatch(include.file)
        beside = None if match is None else self._directory / match[1]
        if match is None or beside is None or not beside.is_file():
            self.found.notes.append(
                f"{source}: line {include.line}: {include.file} is not followed: metadata in it "
                "have no effect; transform it, and include what that gives"
            )
            return []
        if beside not in self._targets:
            self.add(beside, self._out.with_name(f"{self._out.stem}.{match[1]}"))
        written = f"$(dirname)/{self._targets[beside].name}"
        return [launch_file.Edit(include.value, quoteattr(written)[1:-1].encode())]

    def _check_directory(self, source: Path, target: Path, data: bytes, launch: launch_file.Launch) -> None:
        followed = sum(_BESIDE.fullmatch(include.file) is not None for include in launch.includes)
        moved = target.absolute().parent != self._directory
        if moved and data.count(b"$(dirname)") > followed:
            self.found.notes.append(
                f"{source} names files beside it by $(dirname): in the directory of {target} they "
                "may be missing"
            )


@click.command()
@click.argument("meta", type=FILE)
@option("--topic=TOPIC", "the name of this topic of the node")
@option("--service=SERVICE", "the name of this service of the node")
@options.rules
@flag("--thesis-defaults", "unknown-group instead of unknown_group, as in the thesis; ROS has no such names")
@options.as_json
def show_name(
    meta: Path,
    topic: str | None,
    service: str | None,
    rules_path: Path | None,
    thesis_defaults: bool,
    as_json: bool,
) -> None:
    """Show the name that rules give for the metadata in META.

    It is the node's, without --topic or --service. Nothing is renamed, and no right comes of it: it
    is a proposal, for `rossec node request`, or for a program that asks what to publish on.
    """
    if topic is not None and service is not None:
        raise click.UsageError("give --topic or --service, not both")
    kind, which = NameKind.NODE, ""
    if topic is not None:
        kind, which = NameKind.TOPIC, topic
    elif service is not None:
        kind, which = NameKind.SERVICE, service
    sheet, document = rules.read_rules(rules_path), rules.read_metadata(meta)

    async def ask() -> str:
        async with RuleRunner(sheet, thesis_defaults=thesis_defaults) as runner:
            return await runner.name(document, kind, which)

    found = asyncio.run(ask())
    if as_json:
        say_json({"kind": kind.value, "which": which, "name": found})
    else:
        say(found)


@click.command("rules")
def show_rules() -> None:
    """Print the rules that are shipped, to be changed.

    They are those of the thesis, in XSLT 1.0: rossec namespace rules > names.xsl
    """
    say_block(rule_runner.shipped_rules().decode().removesuffix("\n"))


@click.command()
@click.argument("directory", metavar="DIRECTORY", type=OLD_FOLDER)
@json_result()
def messages(directory: Path) -> None:
    """Write the package rossec_namespace into DIRECTORY: the type of the service.

    Programs need it to call /get_topic_name: from rossec_namespace.srv import GetTopicName. The
    directory may be the `src` of a catkin workspace.
    """
    written = str(topic_names.write(directory))
    say(printable(written), path=written)


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
    # A name that rules give is no right: it is judged as if the node had made it up (attack `rules-rights`).
    found = sorted(directory.glob(METADATA_SUFFIX))
    if not found:
        raise ConfigurationError(
            f"there are no metadata in {directory}", f"it is a folder with files {METADATA_SUFFIX}"
        )
    if len(found) > MAX_METADATA_FILES:
        raise ConfigurationError(f"{len(found)} files in {directory} where {MAX_METADATA_FILES} are allowed")
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
@options.rules
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
