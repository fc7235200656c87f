"""`rossec master`: run the ROS master of a trust domain, and ask how it is."""

import asyncio
import logging
import os
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from rossec.authority.local_list import LocalList
from rossec.channel import suite_selection
from rossec.cli.master.audit import AUDIT
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master.operation import config as configs
from rossec.master.operation.admin import AdminPort, ask
from rossec.master.operation.audit_log import audit_written, denials_limited
from rossec.master.operation.config import Config
from rossec.master.operation.denial_log import DenialLog, ignore_denial
from rossec.master.operation.descriptor_limit import raise_descriptor_limit
from rossec.master.operation.json_log import log_as_json
from rossec.master.operation.metrics import MetricsExporter, on_loop
from rossec.master.operation.process_lock import process_lock
from rossec.master.operation.shutdown import stop_on_signals, until_first_ends
from rossec.master.operation.systemd import READY, STOPPING, notify
from rossec.master.rights.statements import Renewer
from rossec.master.server.server import MasterServer
from rossec.master.server.start import master_of
from rossec.ros import settings
from rossec.ros.names import MASTER
from rossec.terminal import printable, say, say_json

_ADMIN = "admin.sock"


@click.group(invoke_without_command=True)
@click.option(
    "--port",
    "-p",
    type=click.IntRange(0, 65535),
    help="instead of the one in ROS_MASTER_URI; 0 for any",
)
@click.option("--json", "as_json", is_flag=True, help="say the address as a line of JSON")
@click.option(
    "--complaints",
    type=click.Path(path_type=Path, dir_okay=False),
    help="append what nodes lack the right to, for: rossec policy learn --from-log",
)
@click.option(
    "--renew-identities", is_flag=True, help="with the intermediate of this host: see rossec ca"
)
@passphrase.option
@click.option(
    "--config",
    "config_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="a configuration file; the other options prevail over it",
)
@click.option("--log", type=click.Choice(["text", "json"]), help="form of the log on stderr")
@click.option("--admin", is_flag=True, help="open the local port of an administrator")
@click.option("--announce", is_flag=True, help="say on the local links where the master is")
@click.option(
    "--metrics", type=click.IntRange(0, 65535), help="serve Prometheus on this port of loopback"
)
@click.option(
    "--post-quantum",
    metavar="POLICY",
    help="off, prefer or require; instead of ROSSEC_POST_QUANTUM",
)
@pass_environment
@click.pass_context
def master(
    context: click.Context,
    environment: Environment,
    port: int | None,
    as_json: bool,
    complaints: Path | None,
    config_file: Path | None,
    log: str | None,
    admin: bool,
    announce: bool,
    metrics: int | None,
    renew_identities: bool,
    passphrase_file: Path | None,
    post_quantum: str | None,
) -> None:
    """Run the master, as the node /master. Ends with Ctrl-C."""
    if context.invoked_subcommand is not None:
        return
    suites = suite_selection.post_quantum(environment.variables, post_quantum)
    config = Config() if config_file is None else configs.load(config_file)
    given: dict[str, Any] = {"port": port, "log": log, "complaints": complaints, "metrics": metrics}
    config = replace(config, **{key: value for key, value in given.items() if value is not None})
    config = replace(config, admin=config.admin or admin, announce=config.announce or announce)
    with ExitStack() as stack:
        if config.log == "json":
            log_as_json()
        raise_descriptor_limit()
        stack.enter_context(denials_limited())
        home = NodeHome.of(environment.home, MASTER)
        home.anchor()  # before anything is written there
        settings.read((), environment.variables, default_name=MASTER)  # likewise
        stack.enter_context(process_lock(home.path))
        if config.audit:
            stack.enter_context(audit_written(home.path / AUDIT, home.signer()))
        renewer = _renewer(environment, passphrase_file) if renew_identities else None
        asyncio.run(_serve(environment, home, config, suites, renewer, as_json=as_json))


@master.command()
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@pass_environment
def status(environment: Environment, as_json: bool) -> None:
    """Say how the running master is; it must have been started with --admin."""
    answer = ask(_home(environment).path / _ADMIN, "status")
    if as_json:
        say_json(answer)
        return
    for key, value in answer.items():
        say(f"{key.replace('_', ' '):<20} {printable(str(value))}")


@master.command()
@pass_environment
def stop(environment: Environment) -> None:
    """End the running master in order; it must have been started with --admin."""
    ask(_home(environment).path / _ADMIN, "stop")
    say("the master ends")


def _home(environment: Environment) -> NodeHome:
    return NodeHome.of(environment.home, MASTER)


async def _serve(
    environment: Environment,
    home: NodeHome,
    config: Config,
    suites: tuple[int, ...],
    renewer: Renewer | None,
    *,
    as_json: bool,
) -> None:
    own = settings.read((), environment.variables, default_name=MASTER)
    stop = stop_on_signals()
    near = LocalList(environment.home)
    newest = near.newest()
    server = master_of(
        home,
        host=own.address,
        port=own.master_port if config.port is None else config.port,
        newest=None if newest is None else newest[0],
        entries=None if newest is None else newest[1],
        find_revocations=near.newest_if_changed,
        renewer=renewer,
        now=now(),
        on_denial=DenialLog(config.complaints) if config.complaints is not None else ignore_denial,
        limits=config.limits,
        suites=suites,
    )
    admin = AdminPort(home.path / _ADMIN, _commands(server))
    exporter = None
    try:
        await _start(server)
        if config.metrics is not None:
            exporter = MetricsExporter(on_loop(server.status), config.metrics)
        if config.admin:
            await admin.start()
        _greet(server, home, exporter, as_json=as_json)
        logging.getLogger("rossec.audit").info("the master began at %s", server.uri)
        notify(READY, environment.variables)
        announcing = (_announce(server, home),) if config.announce else ()
        await until_first_ends(server.stopped(), stop.wait(), *announcing)
        notify(STOPPING, environment.variables)
        logging.getLogger("rossec.audit").info("the master ended")
    finally:
        await admin.close()
        if exporter is not None:
            await asyncio.to_thread(exporter.close)
        await server.close()


async def _start(server: MasterServer) -> None:
    try:
        await server.start()
    except OSError as error:
        if error.filename is not None:  # a file, not the port
            raise
        raise ConfigurationError(
            f"cannot listen on port {server.port}: {os.strerror(error.errno or 0).lower()}",
            "is a master running already? --port, or ROS_MASTER_URI, chooses another port",
        ) from error


def _greet(
    server: MasterServer, home: NodeHome, exporter: MetricsExporter | None, *, as_json: bool
) -> None:
    metrics = {} if exporter is None else {"metrics": f"http://127.0.0.1:{exporter.port}/metrics"}
    if as_json:
        say_json({"ready": server.uri, **metrics})
        return
    say(f"master of {home.anchor().domain} at {server.uri}")
    for uri in metrics.values():
        say(f"metrics at {uri}")


async def _announce(server: MasterServer, home: NodeHome) -> None:
    from rossec.discovery.announcer import announce  # noqa: PLC0415 - carried when it is used

    await announce(home.credentials(), server.uri)


def _commands(server: MasterServer) -> Mapping[str, Any]:
    def stop() -> Mapping[str, Any]:
        server.stop("the administrator of this host")
        return {"stopping": True}

    return {"status": server.status, "stop": stop}


def _renewer(environment: Environment, file: Path | None) -> Renewer:
    """Renews identities with the intermediate of this host, which is unlocked here.

    Raises:
        ConfigurationError: there is none, or it is the root, whose key stays offline.
    """
    from rossec.authority.home import AuthorityHome  # noqa: PLC0415 - as above
    from rossec.authority.renewals import renew  # noqa: PLC0415 - as above

    home = AuthorityHome.at(environment.home)
    authority = home.unlock(passphrase.read(file, environment.variables))
    if authority.authority.is_root:
        raise ConfigurationError(
            f"{home.path} holds the root, which signs no renewals for a master",
            "make an intermediate: rossec ca intermediate request",
        )
    return partial(renew, authority)
