"""Run the relay of a site until it is stopped."""

import asyncio
import logging
import os
import socket
from contextlib import ExitStack, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from rossec import files
from rossec.cli.relay.sites import RELAY_SOCKET, relay_files
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import with_master
from rossec.environment import own_relay
from rossec.errors import ConfigurationError, OverlayUnavailable
from rossec.host.audit import audit_written
from rossec.host.callers import Callers
from rossec.host.local_ports import PortAdmission, find_loopback
from rossec.host.local_sockets import process_lock
from rossec.host.runner import READY, STOPPING, notify, stop_on_signals, until_first_ends
from rossec.master.operation.admin import AdminPort, raise_descriptor_limit
from rossec.overlay.documents import MAX_SEAT_FILE, Routers
from rossec.overlay.endpoint import RouterNetwork
from rossec.overlay.forwarded_ports import OpenDoors
from rossec.overlay.homes import RelayFiles
from rossec.overlay.masters import RelayMember
from rossec.overlay.relay import Relay
from rossec.overlay.zenoh_carrier import Carrier
from rossec.terminal import note, printable, say, say_json

AUDIT: Final = "audit.log"
LOCK: Final = "relay.lock"
AGAIN_AFTER: Final = 2.0  # seconds until routers that are out of reach are tried again
_log = logging.getLogger("rossec.overlay")


def run(environment: Environment, doors: str, seat_file: Path | None, *, as_json: bool) -> None:
    """Run the relay of this host.

    Without an address of `doors` they are on loopback, for this user. `seat_file` is used instead of
    the seat that is kept.
    """
    store = relay_files(environment)
    store.home.anchor()  # before anything is written there
    if seat_file is None:
        routers = store.routers()
    else:
        missing = ConfigurationError(f"there is no {seat_file}", "`rossec router seats add` made it")
        routers = Routers.read(files.read_own(seat_file, MAX_SEAT_FILE, missing, link=True))
    busy = ConfigurationError(f"{store.home.name} runs already", "end it first")
    raise_descriptor_limit()
    with ExitStack() as stack:
        stack.enter_context(process_lock(store.home.path / LOCK, busy))
        stack.enter_context(audit_written(store.home.path / AUDIT, store.home.signer()))
        asyncio.run(_serve(environment, store, routers, doors, as_json=as_json))


async def _serve(
    environment: Environment, store: RelayFiles, routers: Routers, doors: str, *, as_json: bool
) -> None:
    stop = stop_on_signals()
    admission = _admission(doors)
    name = own_relay(environment.variables)
    member = RelayMember(name, await with_master(environment, name))
    carrier = await _carrier(routers, stop)
    if carrier is None:
        return
    relay = Relay(member, RouterNetwork(carrier, routers, member.link_context), admission, store.peers)
    admin = AdminPort(store.home.path / RELAY_SOCKET, {"status": relay.status})
    try:
        await admin.start()
        if as_json:
            say_json({"ready": store.home.name, "router": carrier.router})
        else:
            say(printable(f"relay {store.home.name} of {store.home.anchor().domain} at {carrier.router}"))
            if not store.peers():
                note("it has no peers yet: rossec relay card LABEL, rossec relay add LABEL FILE")
        notify(READY, environment.variables)
        await until_first_ends(relay.run(), stop.wait())
        notify(STOPPING, environment.variables)
    finally:
        await admin.close()
        await carrier.close()


async def _carrier(routers: Routers, stop: asyncio.Event) -> Carrier | None:
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
        with suppress(TimeoutError):
            async with asyncio.timeout(AGAIN_AFTER):
                await stop.wait()
    return None


def _admission(doors: str) -> PortAdmission:
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
