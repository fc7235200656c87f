"""The group `rossec console`, which by itself runs the console."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared.context import Environment
from rossec.cli.shared.lazy import LazyGroup
from rossec.console.options import HAND_OUT_PORT, PORT

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
_FILE: Final = click.Path(path_type=Path)

_PHONES: Final = {
    "remove": ("console.phones:remove", "Let the phone NAME approve nothing any more."),
}


@click.group(cls=LazyGroup, table=_CONSOLE, invoke_without_command=True)
@click.option(
    "--lan", is_flag=True, help="for phones on the network: https, an authority of its own"
)
@click.option("--name", metavar="NAME", help="what browsers call it; --lan: HOSTNAME.local")
@click.option("--rename", is_flag=True, help="another name or port: every phone is set up anew")
@click.option(
    "--hand-out", is_flag=True,
    help=f"hand its certificate out at port {HAND_OUT_PORT}, for ten minutes",
)  # fmt: skip
@click.option("--tls-cert", "tls_certificate", type=_FILE, help="certificate chain of a real NAME")
@click.option("--tls-key", type=_FILE, help="its private key; both are read again when renewed")
@click.option("--unix", "unix_path", type=_FILE, metavar="PATH", help="for a proxy on this host")
@click.option("--origin", metavar="URL", help="of the proxy: https://NAME")
@click.option("--proxy-user", metavar="NAME", help="whose proxy may connect; by default your own")
@click.option("--read-only", is_flag=True, help="only show: for a screen on the wall")
@click.option("--preview", is_flag=True, help="pictures of real messages, as the node /console")
@click.option("--port", type=click.IntRange(1, 65535), help=f"where it listens; default {PORT}")
@click.option("--demo", "is_demo", is_flag=True, help="show the demo's home, and leave nothing")
@click.option("--log", type=click.Choice(["text", "json"]), default="text", help="form of the log")
@click.option("--json", "as_json", is_flag=True, help="say that it is ready as a line of JSON")
@click.pass_context
def console(
    context: click.Context,
    /,
    *,
    log: str,
    as_json: bool,
    rename: bool,
    is_demo: bool,
    **options: object,
) -> None:
    """Show who sees what, and decide: pages for a browser, and the phones that approve.

    Ends with Ctrl-C. The pages are at http://localhost:7411, for this user's programs alone. The
    authority's service has to run: rossec ca serve. A phone that is set up approves with its lock;
    without one they show, refuse and revoke. Other ways: docs/howto/the-console.md.
    """
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.console.serve import Form, serve  # noqa: PLC0415 - when it runs
    from rossec.console.options import Options  # noqa: PLC0415

    found = Options(**options)  # type: ignore[arg-type]  # click has checked each
    if is_demo:
        from rossec.cli.console.show_demo import show_demo  # noqa: PLC0415

        show_demo(context, found)
        return
    serve(context.ensure_object(Environment), found, Form(log, as_json), rename=rename)


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
