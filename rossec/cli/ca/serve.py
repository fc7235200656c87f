"""`rossec ca serve`: the authority as a service, which holds the key and lets nodes join."""

import asyncio
import logging
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import click

from rossec.authority.console import console_socket
from rossec.authority.console.serving import Console
from rossec.authority.home import AUDIT_FILE, AuthorityHome
from rossec.authority.keyservice.face import ANY
from rossec.authority.keyservice.face_process import FaceOptions, FaceProcess
from rossec.authority.keyservice.lock import service_lock
from rossec.authority.keyservice.messages import MAX_UNLOCKED, SOCKET
from rossec.authority.keyservice.network import NetworkWork
from rossec.authority.keyservice.process import (
    KeyServiceProcess,
    audit_to,
    operations_of,
)
from rossec.cli.shared import options, passphrase, rules
from rossec.cli.shared.context import Environment, UnlockTime, pass_environment
from rossec.cli.shared.master import master_at
from rossec.cli.shared.own_address import own_address
from rossec.clock import format_duration
from rossec.enrollment import address
from rossec.enrollment.address import JOIN_PORT
from rossec.errors import ConfigurationError
from rossec.net.host.peeruid import UnixPeer
from rossec.operation.audit_log import AUDIT, audit_written
from rossec.operation.json_log import log_as_json
from rossec.operation.process_memory import protect_memory
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.ros import settings
from rossec.terminal import say, say_json

OPERATOR = "the operator who started it"


@click.command()
@click.option(
    "--unlock-for", "seconds", type=UnlockTime(MAX_UNLOCKED), default="15m", show_default=True,
    help="how long the key is held; 0: while it runs",
)  # fmt: skip
@click.option("--locked", is_flag=True, help="start without the key: rossec ca unlock")
@click.option(
    "--join-address", metavar="HOST:PORT", default=f"{ANY}:{JOIN_PORT}", show_default=True,
    help="where nodes with an invitation join; *: every address of this host",
)  # fmt: skip
@click.option("--no-network", is_flag=True, help="only serve the commands of this host")
@click.option("--apply", "applies", is_flag=True, help="put the policy in force, and keep it so")
@click.option(
    "--renewals/--no-renewals", "renews", default=True,
    help="renew the identities of nodes that are enrolled, before they end (the default)",
)  # fmt: skip
@options.policy
@click.option(
    "--rules", "rules_path", type=options.FILE, metavar="FILE",
    help="name nodes that join with metadata by these rules; without, none is named",
)  # fmt: skip
@options.master_uri
@click.option(
    "--console-user", metavar="NAME", help="another user whose console may show this authority"
)
@click.option(
    "--console-socket", "console_socket_path", type=click.Path(path_type=Path), metavar="PATH",
    help="where the console finds it; for --console-user",
)  # fmt: skip
@click.option("--log", type=click.Choice(["text", "json"]), default="text", help="form of the log")
@click.option("--json", "as_json", is_flag=True, help="say that it is ready as a line of JSON")
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
    names = None if rules_path is None else rules.read_rules(rules_path)
    uri = master_at(environment, home.node(), master_uri)
    settings.parse_uri(uri, "the master's URI")
    where = console_socket.place(home.path, console_socket_path, console_user)
    options_of_face = FaceOptions(join_address, uri, log)
    with ExitStack() as stack:
        protect_memory()
        stack.enter_context(service_lock(home.path))
        audit = stack.enter_context(audit_written(home.path / AUDIT_FILE, home.node().signer()))
        face = None if no_network else FaceProcess(home, options_of_face, environment.variables)
        operations = operations_of(home, audit_to(audit), lambda: face.port if face else 0)
        network = None
        if face is not None:
            stack.callback(face.close)
            face.spawn()  # before there is a key
            network = NetworkWork(
                environment.home, operations, face, applies=applies, policy=policy_path,
                rules=names, renews=renews,
            )  # fmt: skip
        if not locked:
            secret = passphrase.read(passphrase_file, environment.variables)
            operations.unlock(secret, seconds, OPERATOR)
            del secret
        reached = lambda: _join_address(environment, join_address, face)  # noqa: E731 - one expression
        console = Console(where, environment.home, operations, network, policy_path, reached)
        admit = _Admission(console, face).admit
        process = KeyServiceProcess(home, operations, admit, console.access.phone_code)
        serving = _Serving(environment, home, process, console, face, network)
        asyncio.run(serving.run(as_json=as_json))


@dataclass
class _Admission:
    """Who may use the service's socket: neither the network face nor the console's pages."""

    console: Console
    face: FaceProcess | None

    def admit(self, peer: UnixPeer) -> None:
        """Raise `PeerUserRefused` for one of them."""
        if self.face is not None:
            self.face.admit(peer)
        self.console.peers.refuse(peer)


@dataclass
class _Serving:
    """What runs."""

    environment: Environment
    home: AuthorityHome
    process: KeyServiceProcess
    console: Console
    face: FaceProcess | None
    network: NetworkWork | None

    async def run(self, *, as_json: bool) -> None:
        """Serve until a signal."""
        audit, stop = logging.getLogger(AUDIT), stop_on_signals()
        try:
            await self.process.start()
            await self.console.socket.start()
            audit.info("the service began")
            tasks = [self._until_stopped(stop, as_json=as_json), self.process.watch_time()]
            tasks.append(self.network.run() if self.network else self.console.rounds.run())
            await until_first_ends(*tasks)
        finally:
            await self.console.socket.close()
            await self.process.close()
            audit.info("the service ended")

    async def _until_stopped(self, stop: asyncio.Event, *, as_json: bool) -> None:
        port = None if self.face is None else await self.face.started()
        self._print_state(port, as_json=as_json)
        notify(READY, self.environment.variables)
        await stop.wait()
        notify(STOPPING, self.environment.variables)

    def _print_state(self, port: int | None, *, as_json: bool) -> None:
        remaining = self.process.operations.held.remaining()
        if as_json:
            path = str(self.home.path / SOCKET)
            about: dict[str, object] = {"remaining": remaining, "join_port": port}
            say_json({"ready": path, "console": str(self.console.where.path), **about})
            return
        say(f"authority of {self.home.domain}: {describe_remaining(remaining)}")
        if port:
            say(f"nodes join at port {port}: rossec ca invite PATTERN")


def _join_address(environment: Environment, given: str, face: FaceProcess | None) -> str:
    """Where nodes reach the join port, for a code.

    Raises:
        ConfigurationError: there is none.
    """
    if face is None or not face.port:
        raise ConfigurationError(
            "this service has no join port", "start it without --no-network: rossec ca serve"
        )
    host = address.split(given.replace(ANY, "localhost", 1), JOIN_PORT)[0]
    return address.join(own_address(environment) if given.startswith(ANY) else host, face.port)


def describe_remaining(remaining: int | None) -> str:
    """Whether the key is held, and for how long (`HeldKey.remaining`), for people."""
    if remaining is None:
        return "locked; unlock it with: rossec ca unlock --for 15m"
    return f"unlocked for {format_duration(remaining)}" if remaining else "unlocked while it runs"
