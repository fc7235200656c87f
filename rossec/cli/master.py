"""`rossec master | audit`: run the master until it is stopped; what it denied, and what was administered."""

import asyncio
import logging
import os
from collections.abc import Mapping
from contextlib import AsyncExitStack, ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import click

from ca.keys.signing import thumbprint
from rossec.authority.local_list import LocalList
from rossec.channel import opening
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import own_variables
from rossec.cli.shared.options import NEW_FILE, flag, option
from rossec.cli.status import ADMIN_SOCKET
from rossec.clock import format_time
from rossec.environment import own_master
from rossec.errors import ConfigurationError
from rossec.federation import Mesh, mesh_of, read_config
from rossec.files import lines, open_text
from rossec.home import NodeHome
from rossec.host import audit as audits
from rossec.host.audit import audit_written
from rossec.host.local_sockets import process_lock
from rossec.host.runner import log_as_json, stop_on_signals, until_stopped
from rossec.master import operation
from rossec.master.rights.renewals import Renewer
from rossec.master.server import DenialLog, MasterServer, ignore_denial, master_of
from rossec.ros import names
from rossec.terminal import note, printable, say, say_json

LOCK: Final = "master.lock"


AUDIT = "audit.log"
_MOST_DAMAGED = 10_000  # lines; a file with more is not an audit
_MOST_SHOWN = 20
_NOTES = {"left_out": "lines like it before it were left out", "cut_short": "bytes before it were cut short"}


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


@click.command()
@flag("--json as_json", "the lines as they are")
@option("--since", "seconds since the epoch", type=click.IntRange(0))
@flag("--verify verified", "check that nothing was changed")
@option("--after=HASH", "the last hash of the parts before, which are gone")
@option("--key=HEX", "thumbprint of the key the master had then")
@flag("--ca of_authority", "the audit of `rossec ca serve` instead")
@click.argument("files", nargs=-1, type=NEW_FILE)
@pass_environment
def audit(
    environment: Environment,
    as_json: bool,
    since: int | None,
    verified: bool,
    after: str | None,
    key: str | None,
    of_authority: bool,
    files: tuple[Path, ...],
) -> None:
    """Show the master's audit: what was denied, and what was administered.

    With --ca: what the authority's service signed, and for whom. FILES are the audit in the order
    of its parts, by default the one that is written now.
    """
    if of_authority:
        from rossec.authority.home import AUDIT_FILE, AuthorityHome  # noqa: PLC0415 - not for a master

        authority = AuthorityHome.at(environment.home)
        writer, usual = authority.node(), authority.path / AUDIT_FILE
    else:
        writer = NodeHome.of(environment.home, own_master(environment.variables))
        usual = writer.path / AUDIT
    entries: list[audits.Entry] = []
    for path in files or (usual,):
        missing = ConfigurationError(f"there is no {path}", "has the master run here? with --ca: the service")
        with open_text(path, missing) as file:
            most = 1 if verified else _MOST_DAMAGED
            found, damaged = audits.read_entries(lines(file, audits.LINE_LIMIT + 2), most)
        if damaged and verified:
            raise ConfigurationError(f"line {damaged[0]} of {path} is damaged", "compare a backup")
        _note_damage(path, damaged)
        entries += found
    last = audits.verify(entries, after) if verified else ""
    if verified and entries:
        known = _key(writer, key)
        if remark := audits.check_beginning(entries[0], known, after):
            note(remark)
    for entry in entries:
        if since is None or entry["at"] >= since:
            more = "".join(f" ({entry[key]} {text})" for key, text in _NOTES.items() if key in entry)
            line = printable(f"{format_time(int(entry['at']))}  {entry['text']}{more}")
            say(audits.encode(entry) if as_json else line)
    if verified:
        # A removed end is found only by comparing the last hash with one that was noted.
        note(f"nothing was changed in {len(entries)} lines; the last is {last}")


def _key(home: NodeHome, given: str | None) -> bytes | None:
    if given is None:
        return thumbprint(home.signer().public_key) if (home.path / "node.key").exists() else None
    try:
        return bytes.fromhex(given)
    except ValueError:
        raise ConfigurationError(f"{given!a} is not a thumbprint", "64 hexadecimal digits") from None


def _note_damage(path: Path, damaged: list[int]) -> None:
    if len(damaged) == _MOST_DAMAGED:
        raise ConfigurationError(
            f"{len(damaged)} of the first {damaged[-1]} lines of {path} are damaged",
            "is it the right file? if so, compare a backup",
        )
    for number in damaged[:_MOST_SHOWN]:
        note(f"line {number} of {path} is damaged and not shown")
    if more := len(damaged[_MOST_SHOWN:]):
        note(f"{more} more lines of {path} are damaged and not shown")
