"""Gateways that have died: noticed, so that subscribers do not wait for them. A shell.

A gateway replaces the origin's publishers, so nobody else would notice. Each one that serves a
topic is asked for its process id every 2 s, on one connection that stays: one small call, and the
end of a process ends the connection at once. Without an answer for 5 s it is silent, and serves
nothing until it answers again; where nobody listens at its address any more it is unregistered. A
master where nothing is served asks nobody.
"""

import asyncio
import contextlib
import errno
import logging
from typing import Final

from ca.domains.served import is_in_gateway
from rossec.errors import AnswerRefused, RossecError
from rossec.master.server.effects import Effects, MasterState
from rossec.master.state.registry import Kind, NodeRef
from rossec.net.aio.tasks import TaskSet
from rossec.net.rpc.client import RpcClient
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

ASK_EVERY: Final = 2.0  # seconds
RETRY_AFTER: Final = 1.0
ANSWER_WITHIN: Final = 4.0
SILENT_AFTER: Final = 5.0  # since the last answer
_FAILURES: Final = 2  # at least: a master that was stopped itself has asked nobody

_log = logging.getLogger("rossec.master.gateways")
_audit = logging.getLogger("rossec.audit")


class Gateways:
    """Asks the gateways of `state` whether they live, from `start` to `close`."""

    def __init__(self, state: MasterState, effects: Effects) -> None:
        self._state = state
        self._effects = effects
        self._asked: set[NodeRef] = set()
        self._tasks = TaskSet()

    def __len__(self) -> int:
        return len(self._asked)

    def start(self) -> None:
        """Ask those that register from now on."""
        self._effects.on_served = self._served

    async def close(self) -> None:
        """Ask nobody any more."""
        await self._tasks.close()

    def _served(self, topic: str) -> None:
        """The publishers of a served name have changed."""
        for node in self._state.registry.registered_nodes(Kind.PUBLISHER, topic):
            if node not in self._asked:
                self._asked.add(node)
                self._tasks.spawn(self._ask(node), f"asking {node.name}")

    async def _ask(self, node: NodeRef) -> None:
        """Ask a gateway while it serves something."""
        client, loop = _Client(self._effects, self._state.name, node), asyncio.get_running_loop()
        heard, failures = loop.time(), 0
        try:
            while self._topics(node):
                error = await client.ask()
                if error is None:
                    heard, failures = loop.time(), 0
                    self._note(node, silent=False)
                else:
                    failures += 1
                    if failures >= _FAILURES and loop.time() - heard >= SILENT_AFTER:
                        self._give_up(node, error)
                await asyncio.sleep(RETRY_AFTER if failures else ASK_EVERY)
        finally:
            self._asked.discard(node)
            await client.close()

    def _give_up(self, node: NodeRef, error: Exception) -> None:
        if not _is_refused(error):
            self._note(node, silent=True)
        elif self._state.registry.is_current(node):
            _audit.warning("%s is unregistered: nobody listens at %s", node.name, node.uri)
            for event in self._state.registry.remove_node(node.name):
                self._effects.deliver(event)
            self._state.notify()

    def _note(self, node: NodeRef, *, silent: bool) -> None:
        """Note whether a gateway answers, and let subscribers know if that is news."""
        if not self._state.registry.set_silent(node, silent=silent):
            return
        _audit.warning("%s %s", node.name, "does not answer" if silent else "answers again")
        for topic in self._topics(node):
            changes = self._state.aliases.changes(topic, self._state.now())
            self._effects.send_publishers(changes)
        self._state.notify()

    def _topics(self, node: NodeRef) -> list[str]:
        """What a gateway serves: nothing when it is registered no more, or with another address."""
        registry = self._state.registry
        keys = registry.keys_of(node.name, Kind.PUBLISHER) if registry.is_current(node) else ()
        return [key for key in keys if is_in_gateway(key)]


class _Client:
    """One connection to a gateway, made anew after each failure."""

    def __init__(self, effects: Effects, master: str, node: NodeRef) -> None:
        self._effects = effects
        self._master = master
        self._node = node
        self._client: RpcClient | None = None

    async def ask(self) -> Exception | None:
        """Ask for the process id; returns why there is no answer."""
        try:
            async with asyncio.timeout(ANSWER_WITHIN):
                if self._client is None or self._client.closed:
                    self._client = await self._effects.dialer.dial(self._node)
                await self._client.ask("getPid", self._master)
        except (Fault, AnswerRefused):
            return None  # whatever it answers
        except (RossecError, OSError, TimeoutError) as error:
            _log.info("%s does not answer: %s", self._node.name, printable(error))
            await self.close()
            return error
        return None

    async def close(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(RossecError, OSError, TimeoutError):
                async with asyncio.timeout(ANSWER_WITHIN):
                    await client.close()


def _is_refused(error: BaseException | None) -> bool:
    """Whether nobody listens at the address: the process is gone, not just out of reach."""
    while error is not None:
        if isinstance(error, OSError) and error.errno == errno.ECONNREFUSED:
            return True
        error = error.__cause__
    return False
