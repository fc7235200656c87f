"""Run the gateway of a site until it is stopped."""

import asyncio
import logging
from collections.abc import Sequence
from contextlib import AsyncExitStack
from functools import partial

from ca.errors import HintedError
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import node_as
from rossec.cli.status import ADMIN_SOCKET
from rossec.environment import own_gateway
from rossec.errors import ConfigurationError, MasterNotFound, PeerUnreachable
from rossec.gateway import Gateway, TopicRule, status
from rossec.home import NodeHome
from rossec.host.local_sockets import process_lock
from rossec.host.runner import stop_on_signals, until_reached, until_stopped
from rossec.master.operation import AdminPort, raise_descriptor_limit
from rossec.node import Node
from rossec.terminal import note, printable, say, say_json

_log = logging.getLogger("rossec.gateway")


def run(environment: Environment, rules: Sequence[TopicRule], *, as_json: bool) -> None:
    name = own_gateway(environment.variables)
    home = NodeHome.of(environment.home, name)
    home.anchor()  # before anything is written there

    async def serve() -> None:
        stop = stop_on_signals()
        async with AsyncExitStack() as stack:

            def tell(error: HintedError) -> None:
                _log.warning("no master yet, trying again: %s (%s)", error, error.hint)

            async def join() -> Node:
                environment.found.clear()  # what was found before may be why there is none now
                return await stack.enter_async_context(node_as(environment, name))

            # Other refusals are of what is wrong on this host: waiting would not mend them.
            node = await until_reached(join, stop, (PeerUnreachable, MasterNotFound), tell)
            if node is None:
                return
            _check_origins(node, rules)
            serving = Gateway(node, rules)
            admin = AdminPort(home.path / ADMIN_SOCKET, {"status": partial(status, serving, name)})
            stack.push_async_callback(admin.close)
            await admin.start()
            if as_json:
                say_json({"ready": node.name})
            else:
                labels = ", ".join(dict.fromkeys(each.label for each in rules))
                say(printable(f"gateway {node.name} serves topics of {labels}"))
            await until_stopped(stop, environment.variables, serving.run(), node.wait_ended())

    busy = ConfigurationError(f"{name} runs already", "end it first, or take another --name")
    raise_descriptor_limit()
    with process_lock(home.path / "gateway.lock", busy):
        asyncio.run(serve())


def _check_origins(node: Node, rules: Sequence[TopicRule]) -> None:
    granted = node.access.foreign_domains
    for label in dict.fromkeys(each.label for each in rules):
        domain = node.access.domain_called(label)
        if domain is None:
            raise ConfigurationError(
                f"no trusted domain is called {label}",
                f"at this side's authority: rossec domain list, rossec domain accept BUNDLE --as {label}",
            )
        if domain not in granted:
            pattern = next(each.pattern for each in rules if each.label == label)
            note(f"{label} has granted {node.name} nothing yet: nothing of it is served")
            note(
                f"there: rossec grant sign US:{node.name} --certificate"
                f" {node.home.path.name}.pem --subscribe {pattern} --out FILE;"
                " here: rossec grant install FILE"
            )
