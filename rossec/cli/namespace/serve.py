"""`rossec namespace serve`: the node that tells others which names to use."""

import asyncio
from pathlib import Path

import click

from rossec.cli.shared import rules
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as
from rossec.namespace import message_package
from rossec.namespace.topic_names import (
    CALLS,
    CHILDREN,
    DEADLINE,
    SECONDS,
    SERVICE,
    TopicNames,
)
from rossec.naming.runner import RuleRunner
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.terminal import say, say_json


@click.command()
@click.option(
    "--as", "name", metavar="NAME", default="/namespace", show_default=True,
    help="identity to use",
)  # fmt: skip
@rules.option
@click.option("--json", "as_json", is_flag=True, help="say that it runs as a line of JSON")
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
            SERVICE, message_package.service_type(), names.answer, concurrency=CALLS,
            deadline=DEADLINE,
        )  # fmt: skip
        say_json({"ready": node.name}) if as_json else say(f"{node.name} provides {SERVICE}")
        notify(READY, environment.variables)
        await until_first_ends(stop.wait(), node.wait_ended())
        notify(STOPPING, environment.variables)
