"""`rossec relay status`: the links of the running relay."""

from typing import Any

import click

from rossec.cli.relay.home import ADMIN_SOCKET, relay_files
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.status_watch import as_json, show_status, watch
from rossec.master.operation.admin import send_command


@click.command()
@as_json
@watch
@pass_environment
def status(environment: Environment, *, as_json: bool, watch: bool) -> None:
    """Show the links of the running relay.

    To whom they are, how fast, what had to be sent again, and how many connections they carry.
    """
    socket = relay_files(environment).home.path / ADMIN_SOCKET
    show_status(
        lambda: send_command(socket, "status", "relay"),
        _lines, _missing, as_json=as_json, watch=watch,
    )  # fmt: skip


def _missing(answer: dict[str, Any]) -> str:
    return "" if answer["peers"] else "no relay of another site is known: rossec relay card LABEL"


def _lines(answer: dict[str, Any]) -> list[str]:
    router = answer["router"] or "no router is in reach"
    head = f"{answer['relay']} of {answer['domain']}, seat {answer['seat']} at {router}"
    masters = [f"{name}: {why or 'polled for doors'}" for name, why in answer["masters"].items()]
    peers = [line for peer in answer["peers"] for line in _peer(peer)]
    problem = [answer["problem"]] if answer["problem"] else []
    return [f"{head}, {answer['doors']} doors", *masters, *peers, *problem]


def _peer(peer: dict[str, Any]) -> list[str]:
    speed = f"  {peer['rtt_ms']} ms, {peer['retransmissions']} retransmissions"
    called = f", {peer['called']} links from it" if peer["called"] else ""
    error = f"  {peer['error']}" if peer["error"] else ""
    line = (
        f"{peer['label']:<16} {peer['state']:<10} {peer['relay']}"
        f"  {peer['streams']} connections{called}{speed if peer['rtt_ms'] else ''}{error}"
    )
    return [line, *([f"{'':<16} hint: {peer['hint']}"] if peer["hint"] else [])]
