"""The network process: a process of the service that talks to strangers and has no key of it.

`python -I -m rossec.authority.keyservice.front_end`, started by `process.FrontEndProcess`. It is the node
`/ca`: it serves the join port, and calls the master when the service asks for it; what it may ask of the
service is `INNER_OPERATIONS`. It ends when the service does, and the service's own socket refuses it.
"""

import asyncio
import itertools
import logging
import os
import socket
import sys
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final, cast

from ca.encoding import Value
from ca.enrollment import join
from ca.enrollment.invitation import JoinClaim, JoinRequest
from ca.errors import EnrollmentMessageRefused, HintedError
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import InnerAnswer, InnerRefusal, InnerRequest
from rossec.authority.master_connection import master_connection
from rossec.authority.signing import OWN_NODE
from rossec.channel import opening
from rossec.enrollment import DECISION, JoinServer
from rossec.errors import ConfigurationError, KeyMessageRefused, KeyServiceRefused, NotDelivered
from rossec.home import NodeHome
from rossec.host import addresses, runner, sandbox, workers
from rossec.net.rpc import CALL_DEADLINE
from rossec.peer_limits import printable
from rossec.ros.xmlrpc import Fault

MAX_REQUESTS: Final = 512  # of the other side at a time; a join port has 256 sessions
_FAILED: Final = "the other process could not do it", "its log says why"
_ENDED: Final = "the network process of the authority's service has ended"
_channel_log = logging.getLogger("rossec.authority.service")

Handler = Callable[..., Awaitable[Value]]


class InnerChannel:
    """The socketpair between the service and its network process, as calls in both directions: a side that
    breaks the protocol ends the connection, and with it the network process; the service starts a new one.

    `sock`: the end of the socketpair. `handlers`: what the other side may ask; called with the arguments
    of the operation. Raise `HintedError` to refuse. `limit`: bytes of a message from the other side.
    """

    def __init__(self, sock: socket.socket, handlers: Mapping[str, Handler], limit: int) -> None:
        self._socket = sock
        self._handlers = handlers
        self._limit = limit
        self._numbers = itertools.count()
        self._waiting: dict[int, asyncio.Future[Value]] = {}
        self._tasks = runner.TaskSet()
        self._writer: asyncio.StreamWriter | None = None
        self._connected = asyncio.Event()

    async def run(self) -> None:
        reader, self._writer = await asyncio.open_connection(sock=self._socket)
        self._connected.set()
        try:
            while True:
                body = await workers.read_frame(reader, partial(messages.frame_size, limit=self._limit))
                self._take(messages.read(body, self._limit))
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            self._writer.transport.abort()
            self._writer = None
            for future in self._waiting.values():
                if not future.done():
                    future.set_exception(KeyServiceRefused(_ENDED, "it is started again"))
            await self._tasks.close()

    async def call(self, operation: str, *arguments: Value, within: float) -> Value:
        await self._connected.wait()
        if self._writer is None:
            raise KeyServiceRefused(_ENDED, "it is started again")
        number = next(self._numbers) % messages.MAX_NUMBER
        frame = messages.write(InnerRequest(number, operation, arguments))
        answer: asyncio.Future[Value] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answer  # taken out below, also where this is cancelled
        try:
            async with asyncio.timeout(within):
                self._writer.write(frame)
                await self._writer.drain()
                return await answer
        except ConnectionError as error:
            raise KeyServiceRefused(_ENDED, "it is started again") from error
        finally:
            del self._waiting[number]

    def _take(self, message: messages.InnerMessage) -> None:
        if isinstance(message, InnerRequest):
            # Bounded, and of the table (`face-takeover`): a face that was taken over asks for no more.
            if message.operation not in self._handlers or len(self._tasks) >= MAX_REQUESTS:
                raise KeyMessageRefused(f"a request {message.operation} that may not be made now")
            self._tasks.spawn(self._carry_out(message), name=message.operation)
            return
        future = self._waiting.get(message.number)  # None: it was given up
        if future is None or future.done():
            return
        if isinstance(message, InnerRefusal):
            future.set_exception(KeyServiceRefused(message.message, message.hint))
        else:
            future.set_result(message.value)

    async def _carry_out(self, request: InnerRequest) -> None:
        try:
            value = await self._handlers[request.operation](*request.arguments)
            frame = messages.write(InnerAnswer(request.number, value))
        except HintedError as error:
            frame = messages.write(InnerRefusal(request.number, str(error), error.hint))
        except Exception:  # noqa: BLE001 - the other side would wait for an answer
            _channel_log.exception("a request %s of the other process failed", request.operation)
            frame = messages.write(InnerRefusal(request.number, *_FAILED))
        if self._writer is not None:
            self._writer.write(frame)
            await self._writer.drain()


ANY: Final = "*"  # as the host of a join address: every address of this host
_ODD: Final = "the service does not answer as it should"
_FRESH: Final = 10.0  # seconds for which the own identity is not read again
_log = logging.getLogger("rossec.authority.front_end")


class FrontEnd:
    """`node`: the directory of `/ca`. `join_address`: `host:port`; the host may be `ANY`."""

    def __init__(self, node: NodeHome, join_address: str, master_uri: str, suites: tuple[int, ...]) -> None:
        self._node = node
        self._join_address = join_address
        self._master_uri = master_uri
        self._suites = suites
        self._identity: join.LiveIdentity | None = None
        self._read_at = 0.0
        report = partial(_log.warning, "refused at the join port: %s")
        self._server = JoinServer(self._live, self._admit, report, name=self._name)
        self._channel: InnerChannel | None = None

    async def run(self, sock: socket.socket) -> None:
        handlers = {messages.CALL: self._call}
        channel = self._channel = InnerChannel(sock, handlers, messages.MAX_FROM_SERVICE)
        try:
            await runner.until_first_ends(channel.run(), self._serve(channel))
        finally:
            await self._server.close()

    async def _serve(self, channel: InnerChannel) -> None:
        # Listen, and say so; returns if that is not possible.
        try:
            text = self._join_address
            if text == ANY or text.startswith(f"{ANY}:"):
                host: str | None = None
                port = addresses.split(f"localhost{text[1:]}", addresses.JOIN_PORT)[1]
            else:
                host, port = addresses.split(text, addresses.JOIN_PORT)
            await self._server.listen(host, port)
        except (OSError, HintedError) as error:
            reason = os.strerror(error.errno or 0) if isinstance(error, OSError) else str(error)
            what = f"cannot listen on {self._join_address}: {reason.lower()}"
            hint = "choose another one: --join-address HOST:PORT"
            await channel.call(messages.FAILED, what, hint, within=DECISION)
            return
        await channel.call(messages.READY, self._server.port, within=DECISION)
        await asyncio.Event().wait()

    def _live(self) -> join.LiveIdentity:
        now = asyncio.get_running_loop().time()
        if self._identity is None or now - self._read_at > _FRESH:
            own, root = self._node.credentials(), self._node.anchor().certificate
            self._identity, self._read_at = join.LiveIdentity(own.signer, own.chain, root), now
        return self._identity

    async def _admit(self, request: JoinRequest) -> join.JoinAnswer:
        found = await self._ask(messages.JOIN, request.to_bytes())
        if not isinstance(found, join.Issued | join.WaitingMessage | join.RefusedMessage):
            raise EnrollmentMessageRefused(_ODD)
        return found

    async def _name(self, claim: JoinClaim) -> join.NameAnswer:
        found = await self._ask(messages.NAME, claim.to_bytes())
        if not isinstance(found, join.Named | join.RefusedMessage):
            raise EnrollmentMessageRefused(_ODD)
        return found

    async def _ask(self, operation: str, data: bytes) -> join.JoinMessage | None:
        if self._channel is None:
            raise ConfigurationError("the service is not there yet")
        answer = await self._channel.call(operation, data, within=DECISION)
        return join.read(answer) if isinstance(answer, bytes) else None

    async def _call(self, method: str, arguments: list[Value], seconds: int) -> Value:
        try:
            async with asyncio.timeout(seconds):
                own, anchor = self._node.credentials(), self._node.anchor()
                deadline = max(CALL_DEADLINE, float(seconds))
                connection = master_connection(own, anchor, self._master_uri, self._suites, deadline)
                async with connection as client:
                    answer = await client.ask(method, self._node.name, *arguments)
                    return cast("Value", answer)  # the frame says what it may be
        except (HintedError, OSError, TimeoutError, Fault) as error:
            reason = error.faultString if isinstance(error, Fault) else str(error)
            shown = printable(reason) or "no answer in time"
            raise NotDelivered(f"{self._master_uri}: {shown}") from error


def main(arguments: list[str]) -> None:
    descriptor, directory, join_address, master_uri, log = arguments
    if log == "json":
        runner.log_as_json()
    else:  # as the service itself writes, whose terminal or journal this is
        logging.basicConfig(level=logging.WARNING, format="rossec: %(levelname)s: %(message)s")
    sandbox.protect_memory()
    suites = opening.post_quantum(os.environ)

    async def run() -> None:
        face = FrontEnd(NodeHome(Path(directory), OWN_NODE), join_address, master_uri, suites)
        with suppress(KeyServiceRefused):  # the service has ended
            await face.run(socket.socket(fileno=int(descriptor)))

    # `face-takeover` (docs/threat-model.md): of the authority it reads its own node only, so neither the
    # encrypted key nor the record or a passphrase beside them.
    workers.run_confined(run, [Path(directory)])


if __name__ == "__main__":
    main(sys.argv[1:])
