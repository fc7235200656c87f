"""Run the relay of a site until it is stopped."""

import asyncio
import logging
import os
import socket
from contextlib import ExitStack
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from rossec import files
from rossec.cli.relay.home import ADMIN_SOCKET, relay_files
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import with_master
from rossec.environment import own_relay
from rossec.errors import ConfigurationError, OverlayUnavailable
from rossec.master.operation.admin import AdminPort
from rossec.master.operation.descriptor_limit import raise_descriptor_limit
from rossec.operation.audit_log import audit_written
from rossec.operation.process_lock import process_lock
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.overlay.doors import OpenDoors
from rossec.overlay.member import RelayMember
from rossec.overlay.network import RouterNetwork
from rossec.overlay.relay import Relay
from rossec.overlay.relay_files import RelayFiles
from rossec.overlay.routers import MAX_FILE, Routers
from rossec.overlay.zenoh_carrier import Carrier
from rossec.sidecar.callers import Callers
from rossec.sidecar.loopback_port import Admission, find_loopback
from rossec.terminal import note, printable, say, say_json

AUDIT: Final = "audit.log"
LOCK: Final = "relay.lock"
AGAIN_AFTER: Final = 2.0  # seconds until routers that are out of reach are tried again
_log = logging.getLogger("rossec.overlay")


def run(environment: Environment, doors: str, seat_file: Path | None, *, as_json: bool) -> None:
    """Run the relay of this host.

    Args:
        environment: of the command.
        doors: the address of doors; empty: loopback, for this user.
        seat_file: the seat, instead of the one that is kept.
        as_json: say that it runs as a line of JSON.

    Raises:
        HintedError: the relay cannot start, or a part of it has failed.
    """
    store = relay_files(environment)
    store.home.anchor()  # before anything is written there
    routers = store.routers() if seat_file is None else _read_seat(seat_file)
    busy = ConfigurationError(f"{store.home.name} runs already", "end it first")
    raise_descriptor_limit()
    with ExitStack() as stack:
        stack.enter_context(process_lock(store.home.path / LOCK, busy))
        stack.enter_context(audit_written(store.home.path / AUDIT, store.home.signer()))
        asyncio.run(_serve(environment, store, routers, doors, as_json=as_json))


def _read_seat(file: Path) -> Routers:
    missing = ConfigurationError(f"there is no {file}", "`rossec router seats add` made it")
    return Routers.read(files.read_own(file, MAX_FILE, missing, link=True))


async def _serve(
    environment: Environment,
    store: RelayFiles,
    routers: Routers,
    doors: str,
    *,
    as_json: bool,
) -> None:
    stop = stop_on_signals()
    admission = _admission(doors)
    name = own_relay(environment.variables)
    member = RelayMember(name, await with_master(environment, name))
    carrier = await _carrier(routers, stop)
    if carrier is None:
        return
    relay = Relay(
        member, RouterNetwork(carrier, routers, member.link_context), admission, store.peers
    )
    admin = AdminPort(store.home.path / ADMIN_SOCKET, {"status": relay.status})
    try:
        await admin.start()
        _say_ready(store, carrier, as_json=as_json)
        notify(READY, environment.variables)
        await until_first_ends(relay.run(), stop.wait())
        notify(STOPPING, environment.variables)
    finally:
        await admin.close()
        await carrier.close()


async def _carrier(routers: Routers, stop: asyncio.Event) -> Carrier | None:
    """A session with the routers; None: stopped before there was one."""
    said = ""
    while not stop.is_set():
        try:
            return await Carrier.open(routers)
        except OverlayUnavailable as error:
            if isinstance(error.__cause__, ImportError):
                raise
            if said != str(error):
                _log.warning("%s (%s); trying again", error, error.hint)
            said = str(error)
        try:
            async with asyncio.timeout(AGAIN_AFTER):
                await stop.wait()
        except TimeoutError:
            continue
    return None


def _admission(doors: str) -> Admission:
    """Where doors are, and who may use them.

    Raises:
        ConfigurationError: not an address of this host.
    """
    if not doors:
        return Callers({os.geteuid()}, loopback=find_loopback())
    try:
        address = str(ip_address(doors))
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as sock:
            sock.bind((address, 0))
    except (ValueError, OSError) as error:
        raise ConfigurationError(
            f"{doors[:80]} is not an address of this host", "--doors 192.168.1.5, as ROS_IP is"
        ) from error
    return OpenDoors(address)


def _say_ready(store: RelayFiles, carrier: Carrier, *, as_json: bool) -> None:
    if as_json:
        say_json({"ready": store.home.name, "router": carrier.router})
        return
    say(printable(f"relay {store.home.name} of {store.home.anchor().domain} at {carrier.router}"))
    if not store.peers():
        note("it has no peers yet: rossec relay card LABEL, rossec relay add LABEL FILE")
