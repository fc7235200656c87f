"""`rossec discover`: the masters that announce themselves on the local links."""

import asyncio
import socket
import time
from contextlib import suppress

import click

from rossec.cli.shared.busy import working
from rossec.cli.shared.context import Environment, pass_environment
from rossec.discovery.candidates import Candidate
from rossec.discovery.choose import masters, uri_of
from rossec.discovery.finder import PATIENCE
from rossec.terminal import say, say_json


@click.command()
@click.option("--as", "identity", metavar="NAME", help="the node whose master is looked for")
@click.option(
    "--seconds", type=click.FloatRange(0.1, 600), default=PATIENCE, show_default=True,
    help="how long to wait for the first",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="a line of JSON for each")
@pass_environment
def discover(environment: Environment, identity: str | None, seconds: float, as_json: bool) -> None:
    """Look for the masters of this trust domain, the best link first.

    Listens four seconds more than the first takes. Losses are counted by the numbers of the
    announcements, and by the time since the last: the loss of a dead master grows.

    `ROS_MASTER_URI=discover:` makes every command take the first one.
    """
    with working("listening for masters", quiet=as_json):
        found = asyncio.run(masters(environment.home, identity, seconds))
    for one in found:
        row = _row(one)
        if as_json:
            say_json(row)
        else:
            say(
                f"{row['uri']}  {row['name']}  {row['rtt_ms']} ms,"
                f" {row['loss']:.0%} of {row['sent']} lost,"
                f" heard {row['age_s']} s ago, on {row['link']}"
            )


def _row(one: Candidate) -> dict[str, object]:
    link, clock = str(one.source.link), time.monotonic()
    with suppress(OSError):
        link = socket.if_indextoname(one.source.link)
    return {
        "uri": uri_of(one),
        "name": one.name,
        "rtt_ms": round((one.rtt or 0) * 1000, 2),
        "loss": round(one.loss(clock), 2),
        "heard": len(one.heard),
        "sent": one.sent(clock),
        "age_s": round(one.age(clock), 1),
        "link": link,
        "key": one.key.hex(),
    }
