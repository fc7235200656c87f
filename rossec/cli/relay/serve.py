"""Run the relay of a site until it is stopped."""

import asyncio
import logging
import os
import socket
from functools import partial
from ipaddress import ip_address
from pathlib import Path

from ca.errors import HintedError
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
from rossec.host.runner import stop_on_signals, until_reached, until_stopped
from rossec.master.operation import AdminPort, raise_descriptor_limit
from rossec.overlay.documents import MAX_ACCOUNT_FILE, Routers
from rossec.overlay.endpoint import RouterNetwork
from rossec.overlay.forwarded_ports import OpenPorts
from rossec.overlay.masters import RelayMember
from rossec.overlay.relay import Relay
from rossec.overlay.zenoh_carrier import Carrier
from rossec.terminal import note, printable, say, say_json

_log = logging.getLogger("rossec.overlay")


def run(environment: Environment, bind: str, account_file: Path | None, *, as_json: bool) -> None:
    """Run the relay of this host.

    Without an address to `bind` forwarded ports are on loopback, for this user. `account_file` is used
    instead of the account that is kept.
    """
    store = relay_files(environment)
    store.home.anchor()  # before anything is written there
    if account_file is None:
        routers = store.routers()
    else:
        missing = ConfigurationError(f"there is no {account_file}", "`rossec router accounts add` made it")
        routers = Routers.read(files.read_own(account_file, MAX_ACCOUNT_FILE, missing, link=True))

    async def serve() -> None:
        stop = stop_on_signals()
        admission = _admission(bind)
        name = own_relay(environment.variables)
        member = RelayMember(name, await with_master(environment, name))

        def tell(error: HintedError) -> None:
            if isinstance(error.__cause__, ImportError):  # the library is missing: it never comes by itself
                raise error
            _log.warning("%s (%s); trying again", error, error.hint)

        carrier = await until_reached(partial(Carrier.open, routers), stop, OverlayUnavailable, tell)
        if carrier is None:
            return
        relay = Relay(member, RouterNetwork(carrier, routers, member.link_context), admission, store.peers)
        admin = AdminPort(store.home.path / RELAY_SOCKET, {"status": relay.status})
        try:
            await admin.start()
            if as_json:
                say_json({"ready": store.home.name, "router": carrier.router})
            else:
                said = f"relay {store.home.name} of {store.home.anchor().domain} at {carrier.router}"
                say(printable(said))
                if not store.peers():
                    note("it has no peers yet: rossec relay descriptor LABEL, rossec relay add LABEL FILE")
            await until_stopped(stop, environment.variables, relay.run())
        finally:
            await admin.close()
            await carrier.close()

    busy = ConfigurationError(f"{store.home.name} runs already", "end it first")
    raise_descriptor_limit()
    with (
        process_lock(store.home.path / "relay.lock", busy),
        audit_written(store.home.path / "audit.log", store.home.signer()),
    ):
        asyncio.run(serve())


def _admission(bind: str) -> PortAdmission:
    if not bind:
        return Callers({os.geteuid()}, loopback=find_loopback())
    try:
        address = str(ip_address(bind))
        # Bound once to see that it is of this host: forwarded ports are opened later, one for each node.
        with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as sock:
            sock.bind((address, 0))
    except (ValueError, OSError) as error:
        raise ConfigurationError(
            f"{bind[:80]} is not an address of this host", "--bind 192.168.1.5, as ROS_IP is"
        ) from error
    return OpenPorts(address)
