"""The two ports of a node: its slave API, and TCPROS for its topics and services.

Every connection is authenticated before it is handled here. A refused peer receives the error about
its own grants, which reveals nothing of what this node publishes or provides.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError, RevocationsStale
from rossec import clock
from rossec.errors import ConnectionHeaderRefused
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.node.publisher import Publisher
from rossec.node.services import Services
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable
from rossec.participant.own_addresses import OwnAddresses
from rossec.participant.remote_names import caller_for
from rossec.participant.slave_api import SlaveApi
from rossec.participant.slave_rights import SLAVE_CALLS, check_slave_call
from rossec.participant.slave_serving import serve_peer
from rossec.participant.topic_handshake import (
    admit_subscriber,
    check_type,
    publisher_header,
    requested_topic,
)
from rossec.participant.wishes import carried_out, requested_wishes
from rossec.ros import header, names
from rossec.ros.names import SIGNED_UPDATES
from rossec.ros.settings import is_loopback

HEADER_DEADLINE: Final = 5.0

_log = logging.getLogger("rossec.node")


class Listener:
    """Accepts the connections of other nodes."""

    def __init__(
        self,
        name: str,
        context: SecureContext[Identity],
        access: Access,
        publishers: Mapping[str, Publisher],
        services: Services,
        slave: SlaveApi,
        connections: ConnectionTable[SecureStream[Identity]],
        own_addresses: OwnAddresses,
        certified: str,
    ) -> None:
        self._name = name
        self._certified = certified
        self._context = context
        self._access = access
        self._publishers = publishers
        self._services = services
        self._slave = slave
        self._connections = connections
        self._own_addresses = own_addresses
        self._servers: list[SecureServer[Identity]] = []

    @property
    def slave_port(self) -> int:
        """Port of the slave API."""
        return self._servers[0].port

    @property
    def topic_port(self) -> int:
        """Port of TCPROS."""
        return self._servers[1].port

    async def start(self, address: str) -> None:
        """Listen; on loopback only when `address`, which the node registers, is loopback."""
        bind = address if is_loopback(address) else None
        for handler, protocol in (
            (self._serve_slave, WireProtocol.HTTP),
            (self._serve_tcpros, WireProtocol.TCPROS),
        ):
            server = serve(self._connections.bounded(handler), bind, 0, self._context, protocol)
            self._servers.append(server)
            self._own_addresses.add_ports(address, server.port)

    async def close(self) -> None:
        """Stop listening and close the accepted connections."""
        for server in self._servers:
            await server.close()

    async def _serve_slave(self, stream: SecureStream[Identity]) -> None:
        """Serve calls: without a time limit for the master, within `DEADLINE` for other peers."""
        presented: list[bytes] = []
        await serve_peer(stream, partial(self._call, presented), self._access)

    async def _call(
        self, presented: list[bytes], method: str, params: tuple[object, ...], peer: Identity
    ) -> object:
        """Check the peer at every call: it may be revoked while connected, the master too.

        `presented` holds the grants the peer has presented on this connection.
        """
        now = clock.now()
        authorized = False
        try:
            self._access.check_peer(peer, now)
            match method, params:
                case names.PRESENT_GRANTS, (_, bytes() as grants):
                    presented[:] = [grants]
                    return [1, "", 0]
                case _:
                    pass
            if presented and method in SLAVE_CALLS and not self._access.is_master(peer):
                check_slave_call(method, peer, self._name, presented[0], self._access, now)
                authorized = True
        except RevocationsStale as error:
            if method not in SIGNED_UPDATES:  # one of them ends the staleness
                return _refused(peer, error)
        except HintedError as error:
            return _refused(peer, error)
        return await self._slave(method, params, peer, authorized=authorized)

    async def _serve_tcpros(self, stream: SecureStream[Identity]) -> None:
        try:
            async with asyncio.timeout(HEADER_DEADLINE):
                fields = header.decode(await first_frame(stream))
            serve = await self._admit(fields, stream)  # a raw publisher has a limit of its own
        except TimeoutError:
            _log.info("%s sent no connection header", shown(stream.peer.name))
            return
        except HintedError as error:
            _log.warning("refused %s: %s (%s)", shown(stream.peer.name), error, error.hint)
            await stream.send(header.error_header(f"rossec: {error}"))
            return
        await serve()

    async def _admit(
        self, fields: Mapping[str, bytes], stream: SecureStream[Identity]
    ) -> Callable[[], Awaitable[None]]:
        if "service" not in fields:
            return await self._admit_subscriber(fields, stream)
        if "topic" in fields:
            raise ConnectionHeaderRefused(
                "the connection header asks for a topic and for a service"
            )
        return self._services.admit(fields, stream)

    async def _admit_subscriber(
        self, fields: Mapping[str, bytes], stream: SecureStream[Identity]
    ) -> Callable[[], Awaitable[None]]:
        now = clock.now()
        decision = admit_subscriber(fields, stream.peer, self._access, now)
        publisher = self._publishers.get(requested_topic(fields))
        if publisher is None:
            raise ConnectionHeaderRefused(
                f"{self._name} does not publish {requested_topic(fields)}"
            )
        wishes = carried_out(requested_wishes(fields), decision)
        await publisher.ready()
        check_type(fields, publisher.endpoint.expected)
        guard = publisher.guard(decision)
        name = caller_for(stream.peer, self._name, self._certified)
        answer = publisher_header(
            name, publisher.endpoint, self._access, now, latching=publisher.latch
        )
        head = header.encode(answer | wishes.fields)
        return partial(publisher.serve, stream, decision, guard, head, wishes)


def _refused(peer: Identity, error: HintedError) -> list[object]:
    _log.warning("refused %s: %s (%s)", shown(peer.name), error, error.hint)
    return [-1, f"rossec: {error}", 0]


async def first_frame(stream: SecureStream[Identity]) -> bytes:
    """The connection header, which must arrive before anything else.

    Raises:
        ConnectionHeaderRefused: more data arrives before the answer.
    """
    reader = header.FrameReader(header.HEADER_LIMIT)
    while not (frames := reader.feed(await stream.receive())):
        pass
    if len(frames) != 1 or reader.pending:
        raise ConnectionHeaderRefused("bytes after the connection header, before its answer")
    return frames[0]
