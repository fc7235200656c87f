"""`rossec namespace name`: one name, by rules."""

import asyncio
from pathlib import Path

import click

from rossec.cli.shared import options, rules
from rossec.naming.metadata import Kind
from rossec.naming.runner import RuleRunner
from rossec.terminal import say, say_json


@click.command()
@click.argument("meta", type=options.FILE)
@click.option("--topic", metavar="TOPIC", help="the name of this topic of the node")
@click.option("--service", metavar="SERVICE", help="the name of this service of the node")
@rules.option
@click.option(
    "--thesis-defaults", is_flag=True,
    help="unknown-group instead of unknown_group, as in the thesis; ROS has no such names",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
def name(
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
    kind, which = Kind.NODE, ""
    if topic is not None:
        kind, which = Kind.TOPIC, topic
    elif service is not None:
        kind, which = Kind.SERVICE, service
    sheet, document = rules.read_rules(rules_path), rules.read_metadata(meta)
    found = asyncio.run(_name(sheet, document, kind, which, thesis_defaults=thesis_defaults))
    if as_json:
        say_json({"kind": kind.value, "which": which, "name": found})
    else:
        say(found)


async def _name(
    sheet: bytes, document: bytes, kind: Kind, which: str, *, thesis_defaults: bool
) -> str:
    async with RuleRunner(sheet, thesis_defaults=thesis_defaults) as runner:
        return await runner.name(document, kind, which)
