"""A thing of few lines: lakers, this OSCORE, one UDP socket. Also as an attacker.

It is independent of aiocoap's stack of sockets and tokens, so it can send what no stack sends:
messages twice, forged, under other names, or only some of them.
"""

import asyncio
import secrets
from typing import Any, Final

import lakers
from aiocoap import Message
from aiocoap.numbers import codes
from cryptography.hazmat.primitives.asymmetric import ec

from ca.things import ThingKey
from rossec.border import messages
from rossec.border.messages import KEY_SIZE, SALT_SIZE, OscoreContext, unprotected
from rossec.errors import DatagramRefused

EDHOC: Final = (".well-known", "edhoc")
WAIT: Final = 5.0


class RawThing(asyncio.DatagramProtocol):
    """One thing.

    Args:
        border: host and port of the router.
        peer: the router's credential.
        links: what it has.
        state: of its resource `/t`.
    """

    def __init__(
        self,
        border: tuple[str, int],
        peer: ThingKey,
        links: bytes = b"",
        kid: bytes = b"\x2c",
        state: bytes = b"",
        form: int = 60,
    ) -> None:
        self.border, self.peer, self.links = border, peer, links
        key = ec.generate_private_key(ec.SECP256R1())
        self.private = key.private_numbers().private_value.to_bytes(32)
        self.credential = ThingKey.of(key.public_key(), kid)
        self.state, self.form = state, form
        self.sizes: dict[str, int] = {}
        self.received: list[bytes] = []
        self.sent: list[bytes] = []
        self.context: OscoreContext
        self._waiting: dict[bytes, asyncio.Future[Message]] = {}
        self._observers: list[tuple[Message, Any]] = []
        self._mid = secrets.randbelow(0xFFFF)
        self._transport: asyncio.DatagramTransport

    async def start(self) -> None:
        """Open the socket."""
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, remote_addr=self.border)

    def close(self) -> None:
        """Close it."""
        self._transport.close()

    def send(self, data: bytes) -> None:
        """Send any bytes."""
        self.sent.append(data)
        self._transport.sendto(data)

    async def ask(self, message: Message) -> Message:
        """Send a message as CON; its answer."""
        message.token = secrets.token_bytes(4)
        future = self._waiting[message.token] = asyncio.get_running_loop().create_future()
        self.send(self.sealed_bytes(message))
        async with asyncio.timeout(WAIT):
            return await future

    def sealed_bytes(self, message: Message) -> bytes:
        """The bytes of a CON."""
        self._mid = (self._mid + 1) & 0xFFFF
        message.mtype, message.mid = messages.CON, self._mid
        return messages.write(message)

    async def begin(self) -> tuple[Any, bytes]:
        """message_1 and message_2; returns the initiator and C_R."""
        initiator = lakers.EdhocInitiator()
        own_id = bytes((secrets.randbelow(24),))
        message_1 = bytes(initiator.prepare_message_1(own_id, None))
        request = Message(code=codes.POST, uri_path=EDHOC, payload=b"\xf5" + message_1)
        answer = await self.ask(request)
        if answer.code != codes.CHANGED:
            raise DatagramRefused(str(answer.code))
        peer_id, _, _ = initiator.parse_message_2(bytes(answer.payload))
        self.sizes |= {"message_1": len(message_1), "message_2": len(answer.payload)}
        initiator.verify_message_2(self.private, self.credential.ccs, self.peer.ccs)
        self._own_id = own_id
        return initiator, bytes(peer_id)

    async def handshake(self) -> bytes:
        """All of EDHOC but message_3, which the next request is to carry; returns it."""
        initiator, peer_id = await self.begin()
        by_reference = lakers.CredentialTransfer.ByReference
        message_3 = bytes(initiator.prepare_message_3(by_reference, None)[0])
        self.sizes["message_3"] = len(message_3)
        initiator.completed_without_message_4()
        secret = bytes(initiator.edhoc_exporter(0, [], KEY_SIZE))
        salt = bytes(initiator.edhoc_exporter(1, [], SALT_SIZE))
        self.context = OscoreContext(secret, salt, peer_id, self._own_id)
        return message_3

    async def register(self) -> bool:
        """Handshake and registration, as one request."""
        message_3 = await self.handshake()
        return bool(await self.request(codes.POST, ("rd",), message_3=message_3) == codes.CHANGED)

    def protected(self, code: Any, path: tuple[str, ...], message_3: bytes = b"") -> Message:
        """A protected request."""
        sealed, self._identifier = self.context.seal(Message(code=code, uri_path=path))
        if message_3:
            sealed.opt.edhoc, sealed.payload = True, message_3 + sealed.payload
        return sealed

    async def request(self, code: Any, path: tuple[str, ...], message_3: bytes = b"") -> Any:
        """A protected request; the code of its protected answer."""
        sealed = self.protected(code, path, message_3)
        identifier = self._identifier
        answer = await self.ask(sealed)
        opened, _ = self.context.open(answer, identifier)
        return opened.code

    def notify(self, state: bytes) -> None:
        """Another state, to all that observe."""
        self.state = state
        for request, identifier in self._observers:
            self._respond(request, identifier, state, observed=True)

    def datagram_received(self, data: bytes, _: Any) -> None:
        """Answer the router."""
        self.received.append(data)
        message = messages.read(data)
        if message.code.is_response():
            future = self._waiting.pop(bytes(message.token), None)
            if future is not None and not future.done():
                future.set_result(message)
        elif message.code.is_request():
            self._serve(message)

    def error_received(self, exc: Exception) -> None:
        """The router is not there now."""

    def _serve(self, message: Message) -> None:
        try:
            unprotected(message)
            opened, identifier = self.context.open(message)
        except (DatagramRefused, AttributeError):
            return
        if opened.opt.uri_path == (".well-known", "core"):
            self._respond(message, identifier, self.links)
            return
        observed = opened.opt.observe == messages.OBSERVE
        if observed:
            self._observers.append((message, identifier))
        self._respond(message, identifier, self.state, observed=observed, first=True)

    def _respond(
        self, message: Message, identifier: Any, body: bytes, *, observed: bool = False, first: bool = False
    ) -> None:
        answer = Message(code=codes.CONTENT, payload=body, content_format=self.form)
        if observed:
            answer.opt.observe = 0
            identifier.can_reuse_nonce = False
        sealed, _ = self.context.seal(answer, identifier)
        sealed.opt.observe = self.context.sender_sequence_number if observed else None
        sealed.token = message.token
        if observed and not first:
            self._mid = (self._mid + 1) & 0xFFFF
            sealed.mtype, sealed.mid = messages.NON, self._mid
        else:
            sealed.mtype, sealed.mid = messages.ACK, message.mid
        self.sent.append(messages.write(sealed))
        self._transport.sendto(self.sent[-1])
