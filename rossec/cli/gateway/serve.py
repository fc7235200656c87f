"""Run the gateway of a site until it is stopped."""

import asyncio
import logging
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress
from functools import partial
from typing import Final

from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import node_as
from rossec.cli.status import ADMIN_SOCKET
from rossec.environment import own_gateway
from rossec.errors import ConfigurationError, MasterNotFound, PeerUnreachable
from rossec.gateway.gateway import Gateway, status
from rossec.gateway.rules import TopicRule
from rossec.home import NodeHome
from rossec.host.local_sockets import process_lock
from rossec.host.runner import READY, STOPPING, notify, stop_on_signals, until_first_ends
from rossec.master.operation.admin import AdminPort, raise_descriptor_limit
from rossec.node import Node
from rossec.terminal import note, printable, say, say_json

LOCK: Final = "gateway.lock"
AGAIN_AFTER: Final = 2.0  # seconds until a master that is out of reach is tried again
_log = logging.getLogger("rossec.gateway")


def run(environment: Environment, rules: Sequence[TopicRule], *, as_json: bool) -> None:
    name = own_gateway(environment.variables)
    home = NodeHome.of(environment.home, name)
    home.anchor()  # before anything is written there
    busy = ConfigurationError(f"{name} runs already", "end it first, or take another --name")
    raise_descriptor_limit()
    with process_lock(home.path / LOCK, busy):
        asyncio.run(_serve(environment, name, home, rules, as_json=as_json))


async def _serve(
    environment: Environment, name: str, home: NodeHome, rules: Sequence[TopicRule], *, as_json: bool
) -> None:
    stop = stop_on_signals()
    async with AsyncExitStack() as stack:
        node = await _joined(stack, environment, name, stop)
        if node is None:
            return
        _check_origins(node, rules)
        serving = Gateway(node, rules)
        admin = AdminPort(home.path / ADMIN_SOCKET, {"status": partial(status, serving, name)})
        await admin.start()
        try:
            if as_json:
                say_json({"ready": node.name})
            else:
                labels = ", ".join(dict.fromkeys(each.label for each in rules))
                say(printable(f"gateway {node.name} serves topics of {labels}"))
            notify(READY, environment.variables)
            await until_first_ends(serving.run(), node.wait_ended(), stop.wait())
            notify(STOPPING, environment.variables)
        finally:
            await admin.close()


async def _joined(
    stack: AsyncExitStack, environment: Environment, name: str, stop: asyncio.Event
) -> Node | None:
    said = ""
    while not stop.is_set():
        try:
            return await stack.enter_async_context(node_as(environment, name))
        except (PeerUnreachable, MasterNotFound) as error:  # not of what is wrong on this host
            environment.found.clear()
            if said != str(error):
                _log.warning("no master yet, trying again: %s (%s)", error, error.hint)
            said = str(error)
        with suppress(TimeoutError):
            async with asyncio.timeout(AGAIN_AFTER):
                await stop.wait()
    return None


def _check_origins(node: Node, rules: Sequence[TopicRule]) -> None:
    granted = node.access.foreign_domains
    for label in dict.fromkeys(each.label for each in rules):
        domain = node.access.domain_called(label)
        if domain is None:
            raise ConfigurationError(
                f"no trusted domain is called {label}",
                f"at this side's authority: rossec domain list, rossec domain accept CARD --as {label}",
            )
        if domain not in granted:
            pattern = next(each.pattern for each in rules if each.label == label)
            note(f"{label} has granted {node.name} nothing yet: nothing of it is served")
            note(
                f"there: rossec grant sign US:{node.name} --certificate"
                f" {node.home.path.name}.pem --subscribe {pattern} --out FILE;"
                " here: rossec grant install FILE"
            )
