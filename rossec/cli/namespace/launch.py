"""`rossec namespace launch`: a launch file whose metadata become names."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import click

from rossec.cli.shared import options, rules
from rossec.cli.shared.results import json_result
from rossec.errors import RossecError
from rossec.namespace.launch_edit import NamedNode, Query
from rossec.namespace.launch_files import LaunchFiles, read
from rossec.naming.runner import RuleRunner
from rossec.terminal import note, printable, record, say


@click.command("launch")
@click.argument("source", metavar="IN.launch", type=options.FILE)
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, metavar="OUT",
    help="the new file; one that exists is not overwritten",
)  # fmt: skip
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
        _describe(node)
    for text in found.notes:
        note(printable(text))
    if not found.nodes:
        note(f"{source} has no node with metadata")
    record(files=[str(path) for path in found.written], nodes=[each.name for each in found.nodes])
    for path in found.written:
        say(printable(str(path)))


async def _named(source: Path, out: Path, sheet: bytes) -> LaunchFiles:
    async with RuleRunner(sheet) as runner:
        loop = asyncio.get_running_loop()

        def name_of(metadata: bytes, queries: Sequence[Query]) -> list[str]:
            asked = runner.names(metadata, queries)
            return [_name(each) for each in asyncio.run_coroutine_threadsafe(asked, loop).result()]

        return await asyncio.to_thread(read, source, out, name_of)


def _name(result: str | RossecError) -> str:
    if isinstance(result, RossecError):
        raise result
    return result


def _describe(node: NamedNode) -> None:
    note(printable(node.name))
    for entry in node.entries:
        note(printable(f"  {entry.kind} {entry.source} is {entry.name}"))
