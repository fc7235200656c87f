"""`rossec ca serve`: the authority as a service, which holds the key."""

import asyncio
import logging
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import click

from rossec.authority.console import serving
from rossec.authority.home import AUDIT_FILE, AuthorityHome
from rossec.authority.keyservice.client import service_lock
from rossec.authority.keyservice.front_end import ANY
from rossec.authority.keyservice.messages import MAX_UNLOCKED, SOCKET
from rossec.authority.keyservice.network import NetworkWork
from rossec.authority.keyservice.process import (
    FrontEndOptions,
    FrontEndProcess,
    KeyServiceProcess,
    audit_to,
    operations_of,
)
from rossec.cli.ca.home import describe_remaining
from rossec.cli.shared import options, passphrase, rules
from rossec.cli.shared.context import Environment, UnlockTime, pass_environment
from rossec.cli.shared.master import master_at, own_address
from rossec.cli.shared.options import FILE, PATH, flag, option
from rossec.errors import ConfigurationError
from rossec.host import addresses
from rossec.host.audit import AUDIT, audit_written
from rossec.host.local_sockets import UnixPeer
from rossec.host.runner import log_as_json, stop_on_signals, until_first_ends, until_stopped
from rossec.host.sandbox import protect_memory
from rossec.ros import names
from rossec.terminal import say, say_json

OPERATOR = "the operator who started it"


@click.command()
@option(
    "--unlock-for seconds",
    "how long the key is held; 0: while it runs",
    type=UnlockTime(MAX_UNLOCKED),
    default="15m",
    show_default=True,
)
@flag("--locked", "start without the key: rossec ca unlock")
@option(
    "--join-address=HOST:PORT join_address",
    "where nodes with an invitation join; *: every address of this host",
    default=f"{ANY}:{addresses.JOIN_PORT}",
    show_default=True,
)
@flag("--no-network", "only serve the commands of this host")
@flag("--apply applies", "put the policy in force, and keep it so")
@option(
    "--renewals/--no-renewals renews",
    "renew the identities of nodes that are enrolled, before they end (the default)",
    default=True,
)
@options.policy
@option(
    "--rules=FILE rules_path",
    "name nodes that join with metadata by these rules; without, none is named",
    type=FILE,
)
@options.master_uri
@option("--console-user=NAME", "another user whose console may show this authority")
@option(
    "--console-socket=PATH console_socket_path", "where the console finds it; for --console-user", type=PATH
)
@option("--log", "form of the log", type=click.Choice(["text", "json"]), default="text")
@flag("--json as_json", "say that it is ready as a line of JSON")
@passphrase.option
@pass_environment
def serve(
    environment: Environment,
    seconds: int,
    locked: bool,
    join_address: str,
    no_network: bool,
    applies: bool,
    renews: bool,
    policy_path: Path | None,
    rules_path: Path | None,
    master_uri: str | None,
    console_user: str | None,
    console_socket_path: Path | None,
    log: str,
    as_json: bool,
    passphrase_file: Path | None,
) -> None:
    """Hold the authority's key, so that commands need no passphrase. Ends with Ctrl-C.

    Nodes with an invitation join at a port of its own process, which has no key, and get what
    the policy gives their names. With --apply a changed policy is put in force within a minute.
    Identities of nodes are renewed before they end, through the master.
    """
    home = AuthorityHome.at(environment.home)
    if log == "json":
        log_as_json()
    if applies and no_network:
        raise ConfigurationError("--apply delivers grants over the network", "leave --no-network")
    if rules_path is not None and no_network:
        raise ConfigurationError("--rules are for nodes that join", "leave --no-network")
    # Read before there is a key: wrong rules end it, and nothing was unlocked for them.
    joiners = None if rules_path is None else rules.read_rules(rules_path)
    uri = master_at(environment, home.node(), master_uri)
    names.parse_uri(uri, "the master's URI")
    where = serving.place(home.path, console_socket_path, console_user)
    options_of_face = FrontEndOptions(join_address, uri, log)
    with ExitStack() as stack:
        protect_memory()  # first: from here on no core dump and no debugger has the key
        stack.enter_context(service_lock(home.path))
        audit = stack.enter_context(audit_written(home.path / AUDIT_FILE, home.node().signer()))
        face = None if no_network else FrontEndProcess(home, options_of_face, environment.variables)
        operations = operations_of(home, audit_to(audit), lambda: face.port if face else 0)
        network = None
        if face is not None:
            stack.callback(face.close)
            face.spawn()  # before there is a key: what it inherits, whoever breaks into it has
            network = NetworkWork(
                environment.home,
                operations,
                face,
                applies=applies,
                policy=policy_path,
                rules=joiners,
                renews=renews,
            )
        if not locked:
            secret = passphrase.read(passphrase_file, environment.variables)
            operations.unlock(secret, seconds, OPERATOR)
            del secret

        def admit(peer: UnixPeer) -> None:
            # Neither the front end nor the console may use the socket of the commands: it signs.
            if face is not None:
                face.admit(peer)
            console.peers.refuse(peer)

        reached = partial(_join_address, environment, join_address, face)
        console = serving.Console(where, environment.home, operations, network, policy_path, reached)
        process = KeyServiceProcess(home, operations, admit, console.access.phone_code)
        asyncio.run(_serve(environment, home, process, console, face, network, as_json=as_json))


def _join_address(environment: Environment, given: str, face: FrontEndProcess | None) -> str:
    if face is None or not face.port:
        raise ConfigurationError(
            "this service has no join port", "start it without --no-network: rossec ca serve"
        )
    host = addresses.split(given.replace(ANY, "localhost", 1), addresses.JOIN_PORT)[0]
    return addresses.join(own_address(environment) if given.startswith(ANY) else host, face.port)


async def _serve(
    environment: Environment,
    home: AuthorityHome,
    process: KeyServiceProcess,
    console: serving.Console,
    face: FrontEndProcess | None,
    network: NetworkWork | None,
    *,
    as_json: bool,
) -> None:
    audit, stop = logging.getLogger(AUDIT), stop_on_signals()

    async def until_signal() -> None:
        port = None if face is None else await face.started()
        remaining = process.operations.held.remaining()
        if as_json:
            about: dict[str, object] = {"remaining": remaining, "join_port": port}
            say_json({"ready": str(home.path / SOCKET), "console": str(console.where.path), **about})
        else:
            say(f"authority of {home.domain}: {describe_remaining(remaining)}")
            if port:
                say(f"nodes join at port {port}: rossec ca invite PATTERN")
        await until_stopped(stop, environment.variables)

    try:
        await process.start()
        await console.start()
        audit.info("the service began")
        work = network.run() if network else console.rounds.run()
        await until_first_ends(until_signal(), process.watch_time(), work)
    finally:
        await console.close()
        await process.close()
        audit.info("the service ended")
