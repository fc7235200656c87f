"""`rossec namespace name | launch | rules | messages`: one name by rules, or those of a launch file.

A launch file is written beside OUT with those it includes from its own directory. Only `$(dirname)/FILE`
is followed: a file of another directory belongs to somebody else, and what `$(find package)` or an
argument give is known to roslaunch alone. What is not followed is said (`notes`), since metadata in there
would have no effect. No file is overwritten, and nothing is written before everything has its names.
"""

import asyncio
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import click

from rossec import files
from rossec.cli.shared import options, rules
from rossec.cli.shared.options import FILE, NEW_FILE, OLD_FOLDER, flag, json_result, option
from rossec.errors import ConfigurationError, MetadataRefused, RossecError
from rossec.namespace import launch_file, topic_names
from rossec.naming import MAX_INPUT, NameKind, RuleRunner, rule_runner
from rossec.terminal import note, printable, record, say, say_block, say_json

MAX_FILES: Final = 32
_BESIDE: Final = re.compile(r"\$\(dirname\)/([A-Za-z0-9_.-]+)")


@click.command("launch")
@click.argument("source", metavar="IN.launch", type=FILE)
@option("--out=OUT", "the new file; one that exists is not overwritten", type=NEW_FILE, required=True)
@rules.option
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
@rules.option
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
