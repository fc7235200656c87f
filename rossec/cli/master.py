"""Run the master with its audit, metrics and local administrator's port until it is stopped."""

import asyncio
import logging
import os
from collections.abc import Mapping
from contextlib import AsyncExitStack, ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from rossec.authority.local_list import LocalList
from rossec.channel import opening
from rossec.cli.audit import AUDIT
from rossec.cli.shared.context import Environment, now
from rossec.cli.shared.master import own_variables
from rossec.cli.status import ADMIN_SOCKET
from rossec.errors import ConfigurationError
from rossec.federation import Mesh, mesh_of, read_config
from rossec.home import NodeHome
from rossec.host.audit import audit_written
from rossec.host.local_sockets import process_lock
from rossec.host.runner import log_as_json, stop_on_signals, until_stopped
from rossec.master import operation
from rossec.master.rights.renewals import Renewer
from rossec.master.server import DenialLog, MasterServer, ignore_denial, master_of
from rossec.ros import names
from rossec.terminal import say, say_json

LOCK: Final = "master.lock"


def run(
    environment: Environment,
    config_file: Path | None,
    given: Mapping[str, Any],
    passphrase_file: Path | None,
    *,
    renew_identities: bool,
    post_quantum: str | None,
    name: str,
    follow_announced: bool,
    as_json: bool,
) -> None:
    """Run the master; the fields of `Config` that were `given` prevail over the configuration file.

    With `renew_identities` it renews them with the intermediate of this host, whose key
    `passphrase_file` opens.
    """
    suites = opening.post_quantum(environment.variables, post_quantum)
    config = replace(
        operation.Config() if config_file is None else operation.config.load(config_file), **given
    )
    with ExitStack() as stack:
        if config.log == "json":
            log_as_json()
        operation.raise_descriptor_limit()
        stack.enter_context(operation.denials_limited())
        home = NodeHome.of(environment.home, name)
        home.anchor()  # before anything is written there
        own = names.read((), own_variables(environment), default_name=name)  # likewise
        found = read_config(config.federation, str(config_file))
        federation = replace(found, follow_announced=True) if follow_announced else found
        busy = ConfigurationError(
            f"another master runs from {home.path}", "end it first; two would lose each other's parameters"
        )
        stack.enter_context(process_lock(home.path / LOCK, busy))
        if config.audit:
            stack.enter_context(audit_written(home.path / AUDIT, home.signer()))
        renewer = _renewer(environment, passphrase_file) if renew_identities else None

        async def serve() -> None:
            stop = stop_on_signals()
            local_list = LocalList(environment.home)
            newest = local_list.newest()
            server = master_of(
                home,
                host=own.address,
                port=own.master_port if config.port is None else config.port,
                newest=None if newest is None else newest[0],
                entries=None if newest is None else newest[1],
                find_revocations=local_list.newest_if_changed,
                find_domains=local_list.domains_if_changed,
                renewer=renewer,
                now=now(),
                on_denial=DenialLog(config.denial_log) if config.denial_log is not None else ignore_denial,
                limits=config.limits,
                suites=suites,
            )
            mesh = mesh_of(server, home, federation)
            async with AsyncExitStack() as parts:
                parts.push_async_callback(server.close)
                await _start(server)
                exporter = None
                if config.metrics is not None:
                    exporter = operation.MetricsExporter(operation.on_loop(server.status), config.metrics)
                    parts.push_async_callback(asyncio.to_thread, exporter.close)
                admin = operation.AdminPort(home.path / ADMIN_SOCKET, _commands(server, mesh))
                parts.push_async_callback(admin.close)
                if config.admin:
                    await admin.start()
                metrics = {} if exporter is None else {"metrics": f"http://127.0.0.1:{exporter.port}/metrics"}
                if as_json:
                    say_json({"ready": server.uri, **metrics})
                else:
                    say(f"master of {home.anchor().domain} at {server.uri}")
                    for uri in metrics.values():
                        say(f"metrics at {uri}")
                audit = logging.getLogger("rossec.audit")
                audit.info("the master began at %s", server.uri)
                announcing = (_announce(server, home),) if config.announce else ()
                ended = server.stopped(), mesh.run(), *announcing
                await until_stopped(stop, environment.variables, *ended)
                audit.info("the master ended")

        asyncio.run(serve())


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


async def _announce(server: MasterServer, home: NodeHome) -> None:
    from rossec.discovery import announce  # noqa: PLC0415 - carried when it is used

    await announce(home.credentials(), server.uri, version=lambda: server.state.registry.version)


def _commands(server: MasterServer, mesh: Mesh) -> Mapping[str, Any]:
    def stop() -> Mapping[str, Any]:
        server.stop("the administrator of this host")
        return {"stopping": True}

    return {"status": server.status, "stop": stop, "federation": mesh.status}


def _renewer(environment: Environment, file: Path | None) -> Renewer:
    from rossec.authority.renewals import renew  # noqa: PLC0415 - as above
    from rossec.cli.shared.service import service_of  # noqa: PLC0415 - as above

    authority = service_of(environment, file).unlock()
    if authority.authority.is_root:
        raise ConfigurationError(
            f"{authority.path} holds the root, whose service renews identities without this option",
            "leave it out, and run: rossec ca serve",
        )
    return partial(renew, authority)
