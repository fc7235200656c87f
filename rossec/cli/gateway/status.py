"""`rossec gateway status`: what the running gateway serves."""

from typing import Any, Final

import click

from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.status_watch import as_json, show_status, watch
from rossec.environment import own_gateway
from rossec.home import NodeHome
from rossec.master.operation.admin import send_command

ADMIN_SOCKET: Final = "admin.sock"


@click.command()
@as_json
@watch
@pass_environment
def status(environment: Environment, *, as_json: bool, watch: bool) -> None:
    """Show what the running gateway serves, and what not.

    How many here are subscribed to each topic, how many publishers of it are connected at its
    origin, what was forwarded, and why a topic that it should serve is not served.
    """
    home = NodeHome.of(environment.home, own_gateway(environment.variables))
    show_status(
        lambda: send_command(home.path / ADMIN_SOCKET, "status", "gateway"),
        _lines, _missing, as_json=as_json, watch=watch,
    )  # fmt: skip


def _missing(answer: dict[str, Any]) -> str:
    if answer["topics"]:
        return ""
    return "nothing is served: is a topic of these patterns published there, and shown?"


def _lines(answer: dict[str, Any]) -> list[str]:
    problem = f": the graph cannot be followed: {answer['problem']}" * bool(answer["problem"])
    rules = [_rule(each) for each in answer["rules"]]
    topics = [line for each in answer["topics"] for line in _topic(each)]
    skipped = [line for each in answer["skipped"] for line in _skipped(each)]
    left = answer["skipped_count"] - len(answer["skipped"])
    more = [f"and {left} more are not served"] if left else []
    return [f"{answer['gateway']}{problem}", *rules, *topics, *skipped, *more]


def _rule(rule: dict[str, Any]) -> str:
    rate = f", {rule['rate']:g} messages a second" if rule["rate"] is not None else ""
    newest = ", the newest only" if rule["newest"] else ""
    compress = ", compressed" if rule["compress"] else ""
    return f"  from {rule['from']}: {rule['pattern']}{rate}{newest}{compress}"


def _topic(row: dict[str, Any]) -> list[str]:
    line = (
        f"{row['topic']} ({row['type']}) as {row['served']}  {row['state']},"
        f" {row['subscribers']} here, {row['publishers']} there,"
        f" {row['messages']} messages, {row['octets']} bytes"
    )
    return [line, *([f"  {row['problem']}"] if row["problem"] else [])]


def _skipped(row: dict[str, Any]) -> list[str]:
    hint = [f"  hint: {row['hint']}"] if row["hint"] else []
    return [f"{row['topic']} is not served: {row['why']}", *hint]
