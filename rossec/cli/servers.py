"""The groups that run a server when no verb is given."""

from pathlib import Path
from typing import Any, Final

import click
from click.core import ParameterSource

from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, LazyGroup, pass_environment
from rossec.cli.shared.options import FOLDER, NEW_FILE, PATH, flag, option
from rossec.console.options import HAND_OUT_PORT, PORT

_MASTER: Final = {
    "delegate": "grant.delivery:delegate",
    "status": "status:master_status",
    "stop": "status:stop_master",
}
_CONSOLE: Final = {
    "approvals": "phones:approvals",
    "phone": "phones:phone",
    "phones": "servers:phones",
    "tls": "console:tls",
}
_PHONES: Final = {"remove": ("phones:remove", "phone")}
_BORDER: Final = {
    "add": ("border:add", "free"),
    "credential": "border:credential",
    "forget": ("border:forget", "thing"),
    "install": "border:install",
    "labels": "border:labels",
    "list": "border:list_",
    "status": "border:status_",
}
_GATEWAY: Final = {"status": "status:gateway_status"}
_RULES: Final = "rossec.gateway.rules"
_RELAY: Final = {
    "add": ("sites:add_relay", "free"),
    "descriptor": ("sites:descriptor", "free"),
    "list": "sites:list_relays",
    "remove": ("sites:remove_relay", "free"),
    "account": "sites:account",
    "status": "status:relay_status",
}
_ROUTER: Final = {"accounts": "servers:accounts", "share": "sites:share", "take": "sites:take"}
_ACCOUNTS: Final = {
    "add": ("sites:add_account", "free"),
    "list": "sites:list_accounts",
    "remove": ("sites:remove_account", "free"),
    "show": ("sites:show_account", "free"),
}


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
    from rossec.cli.master import run  # noqa: PLC0415 - imported when it runs
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
    from rossec.cli.console import serve  # noqa: PLC0415 - when it runs
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
    from rossec.cli.phones import show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), everything=everything, as_json=as_json)


@click.group(cls=LazyGroup, table=_BORDER, invoke_without_command=True)
@option("--as=NAME router", "its name", default="/border", show_default=True)
@option("--listen=ADDRESS host", "where; :: is everywhere", default="::")
@option("--port", "UDP port; 0 for any", default=5683, show_default=True)
@flag("--json as_json", "say where it listens as a line of JSON")
@flag("--demo is_demo", "show it, with a lamp, in a home of its own")
@pass_environment
@click.pass_context
def border(
    context: click.Context,
    environment: Environment,
    router: str,
    host: str,
    port: int,
    *,
    as_json: bool,
    is_demo: bool,
) -> None:
    """Run the border router of constrained things, as the node /border. Ends with Ctrl-C.

    Things reach it by CoAP (UDP). It serves those whose statement was installed by `install`; one
    that is installed while it runs is served at once.
    """
    if context.invoked_subcommand is not None:
        given = context.get_parameter_source
        if any(given(name) != ParameterSource.DEFAULT for name in context.params):
            raise click.UsageError("options of the router do not stand before a verb")
        return
    if is_demo:
        from rossec.cli.demo import show_border_demo  # noqa: PLC0415 - when it runs

        show_border_demo(context)
        return
    from rossec.cli.border import run  # noqa: PLC0415 - imported when it runs

    run(environment, router, host, port, as_json=as_json)


class GatewayGroup(LazyGroup):
    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if any(word.partition("=")[0] == "--from" for word in args):
            from rossec.cli.gateway_words import split  # noqa: PLC0415 - not needed for help

            try:
                ctx.meta[_RULES], args = split(args)
            except click.UsageError as error:
                error.ctx = ctx  # whose help is hinted at
                raise
        return super().parse_args(ctx, args)


def _misplaced(_: click.Context, option: click.Parameter, value: Any) -> None:
    if value:
        raise click.UsageError(f"{option.opts[0]} stands behind --from and its patterns")


@click.group(cls=GatewayGroup, table=_GATEWAY, invoke_without_command=True)
@option(
    "--from",
    "serve these topics of the domain LABEL, by the names there; may be repeated",
    metavar="LABEL PATTERN...",
    expose_value=False,
    callback=_misplaced,
)
@option("--rate=N", "at most N messages a second of each of them", expose_value=False, callback=_misplaced)
@flag(
    "--newest",
    "of messages that wait for a slow line, send only the newest",
    expose_value=False,
    callback=_misplaced,
)
@flag("--compress", "send them compressed", expose_value=False, callback=_misplaced)
@option(
    "--name=NAME", "which of the domain's gateways: /gateway, or /gateway/attic; instead of ROSSEC_GATEWAY"
)
@flag("--json as_json", "say that it runs as a line of JSON")
@pass_environment
@click.pass_context
def gateway(context: click.Context, environment: Environment, name: str | None, *, as_json: bool) -> None:
    """Run the gateway of this site, as the node /gateway. Ends with Ctrl-C.

    It brings topics of another domain here, once however many listen, and only while somebody
    does. What it gets of them its grant there says; who gets them here, the grants here on
    /gateway/LABEL/NAME. --rate, --newest and --compress are about the --from before them, which
    may be repeated: of several patterns that cover a topic the first one counts.
    """
    if name is not None:
        from rossec.environment import OWN_GATEWAY  # noqa: PLC0415 - not needed for help

        context.obj = environment = Environment({**environment.variables, OWN_GATEWAY: name})
    rules = context.meta.get(_RULES, ())
    if context.invoked_subcommand is not None:
        if rules or as_json:
            raise click.UsageError("only --name stands before a verb")
        return
    if not rules:
        raise click.UsageError("which topics shall it serve? rossec gateway --from hospital /robot/pose")
    from rossec.cli.gateway import run  # noqa: PLC0415 - imported when it runs

    run(environment, rules, as_json=as_json)


@click.group(cls=LazyGroup, table=_RELAY, invoke_without_command=True)
@option(
    "--bind=ADDRESS",
    "listen here for nodes of other hosts of this site; default: loopback, for this user",
    default="",
)
@option(
    "--account=FILE account_file",
    "the routers and the account there, instead of what `rossec relay account` keeps",
    type=NEW_FILE,
)
@option("--name=NAME", "which of the domain's relays: /relay, or /relay/attic; instead of ROSSEC_RELAY")
@flag("--json as_json", "say that it runs as a line of JSON")
@pass_environment
@click.pass_context
def relay(
    context: click.Context,
    environment: Environment,
    bind: str,
    account_file: Path | None,
    name: str | None,
    *,
    as_json: bool,
) -> None:
    """Run the relay of this site, as the node /relay. Ends with Ctrl-C.

    It carries connections of nodes to and from other sites, sealed as they are, through routers
    that learn nothing of them. It needs no port that is reachable from outside.
    """
    if name is not None:
        from rossec.environment import OWN_RELAY  # noqa: PLC0415 - not needed for help

        context.obj = environment = Environment({**environment.variables, OWN_RELAY: name})
    if context.invoked_subcommand is not None:
        if bind or account_file is not None or as_json:
            raise click.UsageError("only --name stands before a verb")
        return
    from rossec.cli.overlay import run_relay  # noqa: PLC0415 - imported when it runs

    run_relay(environment, bind, account_file, as_json=as_json)


@click.group(cls=LazyGroup, table=_ROUTER, invoke_without_command=True)
@option("--home directory", "the router's directory, by default `router` in ROSSEC_HOME", type=FOLDER)
@option(
    "--listen=LOCATOR",
    "where it listens, tls/[::]:7447 by default; also quic/ and tcp/; may be repeated",
    multiple=True,
)
@option(
    "--join=LOCATOR",
    "another router of this operator, tls/other.example.org:7447; may be repeated",
    multiple=True,
)
@option(
    "--host=NAME",
    "name or address by which relays reach it, for its certificate; may be repeated",
    multiple=True,
)
@flag("--open is_open", "let in everybody, without accounts")
@flag("--print-config", "print it for a stock zenohd, and end")
@flag("--json as_json", "say where it listens as a line of JSON")
@pass_environment
@click.pass_context
def router(
    context: click.Context,
    environment: Environment,
    directory: Path | None,
    listen: tuple[str, ...],
    join: tuple[str, ...],
    host: tuple[str, ...],
    is_open: bool,
    print_config: bool,
    as_json: bool,
) -> None:
    """Run a router, through which relays of several sites reach each other. Ends with Ctrl-C.

    It learns random inboxes, sizes and times, nothing else. --listen, --join and --host are kept
    for the next start. An account that is added or removed while it runs is taken over at once.
    """
    from rossec.cli.sites import home_of  # noqa: PLC0415 - imported when it runs

    home = home_of(environment, directory)
    given = {"listen": listen, "join": join, "hosts": host}
    if context.invoked_subcommand is not None:
        if any(given.values()) or is_open or print_config or as_json:
            raise click.UsageError("only --home stands before a verb")
        context.obj = home
        return
    from rossec.cli.overlay import print_settings, run_router  # noqa: PLC0415 - as above

    if print_config:
        print_settings(home, given, is_open=is_open)
        return
    run_router(environment, home, given, is_open=is_open, as_json=as_json)


@click.group(cls=LazyGroup, table=_ACCOUNTS)
def accounts() -> None:
    """Say who may use the router, and make the files for relays.

    An account is for one site: its relay reads the inboxes of its account, and sends to any that it
    knows. A router that runs takes changes over within a second.
    """
