"""Connections a node makes: to its master, and to the nodes that publish what it subscribes to.

A peer is checked before anything is sent: its certificate by the channel, its revocation here.
That a publisher lacks the right shows in its answer only; by then it has received the topic's name,
which the master has sent it as well, and the subscriber's grant for that topic.
"""

from collections.abc import Callable

from ca.certificates import Identity
from ca.domains.aliases import shown
from rossec import clock
from rossec.errors import ConnectionHeaderRefused
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.participant.own_addresses import OwnAddresses
from rossec.participant.remote_names import caller_for
from rossec.participant.wire_names import wire_name
from rossec.ros import settings

CheckPeer = Callable[[Identity, int], None]


class Dialer:
    """Connects as one node; `certified`: its name without a tail, by default the same."""

    def __init__(
        self,
        name: str,
        context: SecureContext[Identity],
        check_peer: CheckPeer,
        own_addresses: OwnAddresses | None = None,
        certified: str = "",
    ) -> None:
        self._name = name
        self._certified = certified or name
        self._context = context
        self._check_peer = check_peer
        self._own_addresses = OwnAddresses() if own_addresses is None else own_addresses

    async def rpc(self, host: str, port: int) -> SecureStream[Identity]:
        """Connect to a master or slave API; the caller checks the peer's identity."""
        return await self._connect(host, port, WireProtocol.HTTP)

    async def topic(self, uri: str, topic: str) -> SecureStream[Identity]:
        """Connect to the TCPROS port that the node at `uri` names in its answer to `requestTopic`.

        At a relay's door that is the door again: the node names an address of its own network.

        Raises:
            RossecError: out of reach, or no connection offered.
            CAError: the peer is revoked, or this is not known.
        """
        api = settings.parse_uri(uri, "a publisher's URI")
        named = await self._request_topic(await self.rpc(*api), topic)
        address = api if settings.is_door(uri) else named
        self._own_addresses.check_redirect(api, address)
        stream = await self._connect(*address, WireProtocol.TCPROS)
        self._check_identity(stream)
        return stream

    async def service(self, uri: str) -> SecureStream[Identity]:
        """Connect to the provider of a service, at its rosrpc URI; raises as `topic`."""
        host, port = settings.parse_uri(uri, "a service's URI", scheme="rosrpc")
        stream = await self._connect(host, port, WireProtocol.TCPROS)
        self._check_identity(stream)
        return stream

    async def _connect(
        self, host: str, port: int, protocol: WireProtocol
    ) -> SecureStream[Identity]:
        to_itself = self._own_addresses.is_own((host, port))
        return await connect(host, port, self._context, protocol, to_itself=to_itself)

    async def _request_topic(self, stream: SecureStream[Identity], topic: str) -> tuple[str, int]:
        self._check_identity(stream)
        try:
            named = wire_name(stream.peer, topic, self._certified)
            caller = caller_for(stream.peer, self._name, self._certified)
            answer = await RpcClient(stream).ask("requestTopic", caller, named, [["TCPROS"]])
        finally:
            stream.close_soon()  # the peer could make this take longer than a caller has
        match answer:
            case ["TCPROS", str() as host, int() as port] if 0 < port < 1 << 16:
                return host, port
            case _:
                raise ConnectionHeaderRefused(
                    f"{shown(stream.peer.name)} offers no connection for {shown(topic)}"
                )

    def _check_identity(self, stream: SecureStream[Identity]) -> None:
        try:
            self._check_peer(stream.peer, clock.now())
        except BaseException:
            stream.abort("the peer's identity is revoked or cannot be checked")
            raise
