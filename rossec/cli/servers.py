"""The groups that run a server when no verb is given: master and console (satellites have their own)."""

from pathlib import Path
from typing import Any, Final

import click

from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, LazyGroup, pass_environment
from rossec.cli.shared.options import NEW_FILE, PATH, flag, option
from rossec.console.options import HAND_OUT_PORT, PORT

_MASTER: Final = {
    "delegate": "grant.delivery:delegate",
    "status": "status:master_status",
    "stop": "status:stop_master",
}
_CONSOLE: Final = {
    "approvals": "console.phones:approvals",
    "phone": "console.phones:phone",
    "phones": "servers:phones",
    "tls": "console.tls:tls",
}
_PHONES: Final = {"remove": ("console.phones:remove", "phone")}


@click.group(cls=LazyGroup, table=_MASTER, invoke_without_command=True)
@option("--port -p", "instead of the one in ROS_MASTER_URI; 0 for any", type=click.IntRange(0, 65535))
@flag("--json as_json", "say the address as a line of JSON")
@option(
    "--denial-log",
    "denial log: append each missing right, for: rossec policy learn --from-log FILE",
    type=NEW_FILE,
)
@flag(
    "--renew-identities", "with the intermediate of this host; without, the authority's service renews them"
)
@passphrase.option
@option("--config config_file", "a configuration file; the other options prevail over it", type=NEW_FILE)
@option("--log", "form of the log on stderr", type=click.Choice(["text", "json"]))
@flag("--admin", "open the local port of an administrator")
@option(
    "--name=NAME name", "which of the domain's masters: /master, or /master/kitchen; instead of ROSSEC_MASTER"
)
@flag("--follow-announced", "follow every announced master of the own domain")
@flag("--announce", "announce the master on the local links")
@option("--metrics", "serve Prometheus on this port of loopback", type=click.IntRange(0, 65535))
@option("--post-quantum=POLICY", "off, prefer or require; instead of ROSSEC_POST_QUANTUM")
@pass_environment
@click.pass_context
def master(
    context: click.Context,
    environment: Environment,
    /,
    *,
    as_json: bool,
    config_file: Path | None,
    name: str | None,
    follow_announced: bool,
    renew_identities: bool,
    passphrase_file: Path | None,
    post_quantum: str | None,
    **given: Any,
) -> None:
    """Run a master, as the node /master. Ends with Ctrl-C."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.master.serve import run  # noqa: PLC0415 - imported when it runs
    from rossec.environment import OWN_MASTER, own_master  # noqa: PLC0415 - as above

    run(
        environment,
        config_file,
        # a flag only switches on
        {key: value for key, value in given.items() if value is not None and value is not False},
        passphrase_file,
        renew_identities=renew_identities,
        post_quantum=post_quantum,
        name=own_master(environment.variables if name is None else {OWN_MASTER: name}),
        follow_announced=follow_announced,
        as_json=as_json,
    )


@click.group(cls=LazyGroup, table=_CONSOLE, invoke_without_command=True)
@flag("--lan", "for phones on the network: https, an authority of its own")
@option("--name=NAME", "what browsers call it; --lan: HOSTNAME.local")
@flag("--rename", "another name or port: every phone is set up anew")
@flag("--hand-out", f"hand its certificate out at port {HAND_OUT_PORT}, for ten minutes")
@option("--tls-cert tls_certificate", "certificate chain of a real NAME", type=PATH)
@option("--tls-key", "its private key; both are read again when renewed", type=PATH)
@option("--unix=PATH unix_path", "for a proxy on this host", type=PATH)
@option("--origin=URL", "of the proxy: https://NAME")
@option("--proxy-user=NAME", "whose proxy may connect; by default your own")
@flag("--read-only", "only show: for a screen on the wall")
@flag("--preview", "pictures of real messages, as the node /console")
@option("--port", f"where it listens; default {PORT}", type=click.IntRange(1, 65535))
@flag("--demo is_demo", "show the demo's home, and leave nothing")
@option("--log", "form of the log", type=click.Choice(["text", "json"]), default="text")
@flag("--json as_json", "say that it is ready as a line of JSON")
@click.pass_context
def console(
    context: click.Context, /, *, log: str, as_json: bool, rename: bool, is_demo: bool, **options: object
) -> None:
    """Show who sees what, and decide: pages for a browser, and the phones that approve.

    Ends with Ctrl-C. The pages are at http://localhost:7411, for this user's programs alone. The
    authority's service has to run: rossec ca serve. A phone that is set up approves with its lock;
    without one they show, refuse and revoke. Other ways: docs/howto/the-console.md.
    """
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.console.serve import serve  # noqa: PLC0415 - when it runs
    from rossec.console.options import ConsoleOptions as Options  # noqa: PLC0415

    found = Options(**options)  # type: ignore[arg-type]  # click has checked each
    if is_demo:
        from rossec.cli.demo import show_console_demo  # noqa: PLC0415

        show_console_demo(context, found)
        return
    serve(context.ensure_object(Environment), found, rename=rename, log=log, as_json=as_json)


@click.group(cls=LazyGroup, table=_PHONES, invoke_without_command=True)
@flag("--all everything", "also those that were removed")
@options.as_json
@click.pass_context
def phones(context: click.Context, everything: bool, as_json: bool) -> None:
    """Show the phones that can approve."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.console.phones import show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), everything=everything, as_json=as_json)
