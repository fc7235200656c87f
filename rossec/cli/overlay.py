"""Run a relay or a router until it is stopped; print a router's settings for a stock `zenohd`."""

import asyncio
import logging
import os
import socket
from collections.abc import Mapping
from functools import partial
from ipaddress import ip_address
from pathlib import Path

from ca.errors import HintedError
from rossec import files
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import with_master
from rossec.cli.sites import RELAY_SOCKET, relay_files
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
from rossec.overlay.homes import RouterHome
from rossec.overlay.masters import RelayMember
from rossec.overlay.relay import Relay
from rossec.overlay.router import Router, accounts_of
from rossec.overlay.router_settings import RouterSettings, nested, zenoh_settings
from rossec.overlay.zenoh_carrier import Carrier
from rossec.terminal import json_text, note, printable, say, say_block, say_json

_log = logging.getLogger("rossec.overlay")


def run_relay(environment: Environment, bind: str, account_file: Path | None, *, as_json: bool) -> None:
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


def run_router(
    environment: Environment,
    home: RouterHome,
    given: Mapping[str, tuple[str, ...]],
    *,
    is_open: bool,
    as_json: bool,
) -> None:
    """Run the router of `home` until a signal ends it; what was `given` is kept for the next start."""
    home.prepare()

    async def serve(settings: RouterSettings) -> None:
        stop = stop_on_signals()
        router = Router(home, settings, is_open=is_open)
        try:
            await router.start()
            if as_json:
                say_json({"ready": list(settings.listen)})
            else:
                say(f"router at {', '.join(settings.listen)}")
                if is_open:
                    note("it is open: whoever reaches it can use it, and count what others send")
                else:
                    say(f"accounts: {', '.join(home.accounts().names)}")
                if settings.join:
                    say(f"joins {', '.join(settings.join)}")
            await until_stopped(stop, environment.variables, router.run())
        finally:
            await router.close()

    with home.alone():
        settings = home.tell(**given)
        accounts_of(home, is_open=is_open)
        asyncio.run(serve(settings))


def print_settings(home: RouterHome, given: Mapping[str, tuple[str, ...]], *, is_open: bool) -> None:
    """Print what `zenohd --config FILE` reads; it names files of `home`, which are made."""
    home.prepare()
    settings = home.tell(**given)
    accounts = accounts_of(home, is_open=is_open)
    home.write_for_zenoh(settings, accounts)
    say_block(json_text(nested(zenoh_settings(settings, accounts, home.files)), 1))
    if accounts is not None:
        note("it holds the password of this router: keep the file to yourself (chmod 600)")
