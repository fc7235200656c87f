"""Run the gateway of a site until it is stopped."""

import asyncio
import logging
from collections.abc import Sequence
from contextlib import AsyncExitStack, ExitStack, suppress
from functools import partial
from typing import Final

from rossec.cli.gateway.status import ADMIN_SOCKET
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import node_as
from rossec.environment import own_gateway
from rossec.errors import ConfigurationError, MasterNotFound, PeerUnreachable
from rossec.gateway.gateway import Gateway, status
from rossec.gateway.rules import TopicRule
from rossec.home import NodeHome
from rossec.master.operation.admin import AdminPort
from rossec.master.operation.descriptor_limit import raise_descriptor_limit
from rossec.node import Node
from rossec.operation.process_lock import process_lock
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.operation.systemd import READY, STOPPING, notify
from rossec.terminal import note, printable, say, say_json

LOCK: Final = "gateway.lock"
AGAIN_AFTER: Final = 2.0  # seconds until a master that is out of reach is tried again
_log = logging.getLogger("rossec.gateway")


def run(environment: Environment, rules: Sequence[TopicRule], *, as_json: bool) -> None:
    """Run the gateway of this host.

    Raises:
        HintedError: it cannot start, or a part of it has failed.
    """
    name = own_gateway(environment.variables)
    home = NodeHome.of(environment.home, name)
    home.anchor()  # before anything is written there
    busy = ConfigurationError(f"{name} runs already", "end it first, or take another --name")
    raise_descriptor_limit()
    with ExitStack() as stack:
        stack.enter_context(process_lock(home.path / LOCK, busy))
        asyncio.run(_serve(environment, name, home, rules, as_json=as_json))


async def _serve(
    environment: Environment,
    name: str,
    home: NodeHome,
    rules: Sequence[TopicRule],
    *,
    as_json: bool,
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
            _say_ready(node, rules, as_json=as_json)
            notify(READY, environment.variables)
            await until_first_ends(serving.run(), node.wait_ended(), stop.wait())
            notify(STOPPING, environment.variables)
        finally:
            await admin.close()


async def _joined(
    stack: AsyncExitStack, environment: Environment, name: str, stop: asyncio.Event
) -> Node | None:
    """The gateway's node, as soon as the master is in reach; None: stopped before."""
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
    """Refuse a label that no trusted domain has; say of a domain that it has granted nothing.

    Raises:
        ConfigurationError: there is no such domain.
    """
    granted = node.access.foreign_domains
    for label in dict.fromkeys(each.label for each in rules):
        domain = node.access.domain_called(label)
        if domain is None:
            raise ConfigurationError(
                f"no trusted domain is called {label}",
                "at this side's authority: rossec domain list, rossec domain accept CARD"
                f" --as {label}",
            )
        if domain not in granted:
            pattern = next(each.pattern for each in rules if each.label == label)
            note(f"{label} has granted {node.name} nothing yet: nothing of it is served")
            note(
                f"there: rossec grant sign US:{node.name} --certificate"
                f" {node.home.path.name}.pem --subscribe {pattern} --out FILE;"
                " here: rossec grant install FILE"
            )


def _say_ready(node: Node, rules: Sequence[TopicRule], *, as_json: bool) -> None:
    if as_json:
        say_json({"ready": node.name})
        return
    labels = ", ".join(dict.fromkeys(each.label for each in rules))
    say(printable(f"gateway {node.name} serves topics of {labels}"))
