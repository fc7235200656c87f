"""The group `rossec console`, which by itself runs the console."""

from typing import Final

import click

from rossec.cli.shared.context import Environment
from rossec.cli.shared.lazy import LazyGroup
from rossec.console.options import PORT

_CONSOLE: Final = {
    "approvals": (
        "console.approvals:approvals",
        "Show who approved what at the console, oldest first, and what came of it.",
    ),
    "phone": (
        "console.phone:phone",
        "Show a one-time code that logs in a phone, and can set it up to approve.",
    ),
    "phones": ("console.group:phones", "Show the phones that can approve."),
    "tls": (
        "console.tls:tls",
        "Show the console's own TLS authority (--lan): its fingerprint, in words and hex.",
    ),
}

_PHONES: Final = {
    "remove": ("console.phones:remove", "Let the phone NAME approve nothing any more."),
}


@click.group(cls=LazyGroup, table=_CONSOLE, invoke_without_command=True)
@click.option("--port", type=click.IntRange(1, 65535), help=f"where it listens; default {PORT}")
@click.option("--log", type=click.Choice(["text", "json"]), default="text", help="form of the log")
@click.option("--json", "as_json", is_flag=True, help="say that it is ready as a line of JSON")
@click.pass_context
def console(context: click.Context, port: int | None, log: str, as_json: bool) -> None:
    """Show who sees what, and decide: pages for a browser. Ends with Ctrl-C.

    They are at http://localhost:7411, for this user's programs alone. The authority's service has
    to run: rossec ca serve. A phone that is set up approves with its lock; without one the pages
    show, refuse and revoke.
    """
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.console.serve import serve  # noqa: PLC0415 - imported when it runs
    from rossec.console.options import Options  # noqa: PLC0415

    serve(context.ensure_object(Environment), Options(port=port), log=log, as_json=as_json)


@click.group(cls=LazyGroup, table=_PHONES, invoke_without_command=True)
@click.option("--all", "everything", is_flag=True, help="also those that were removed")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@click.pass_context
def phones(context: click.Context, everything: bool, as_json: bool) -> None:
    """Show the phones that can approve."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.console.phones import show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), everything=everything, as_json=as_json)
