"""Constrained things made of aiocoap: a server of resources and a client, in one process.

Both classes: `Thing` has a key and speaks EDHOC through lakers, `SecretThing` has a secret and
derives its contexts by RFC 8613 Appendix B.2.
"""

import asyncio
import secrets
from collections.abc import Callable
from typing import Any, Final

import aiocoap
import cbor2
from aiocoap import Message, credentials, oscore, resource
from aiocoap.edhoc import EdhocCredentials
from aiocoap.numbers.codes import Code
from aiocoap.optiontypes import BlockOption
from aiocoap.oscore_sitewrapper import OscoreSiteWrapper
from aiocoap.transports.oscore import OSCOREAddress
from cryptography.hazmat.primitives.asymmetric import ec

from ca.things import ThingKey
from rossec.border.conversations import MAX_BLOCK
from rossec.border.messages import NONCE_SIZE, R2_SIZE, name_context, thing_context, unwrapped, wrapped
from tests.support.ports import free_port

LINKS: Final = ".well-known", "core"


class Value(resource.ObservableResource):  # type: ignore[misc]
    """A resource whose state is set: it is read, observed, and may be written or called."""

    def __init__(self, form: int, state: bytes = b"") -> None:
        super().__init__()
        self.form, self.state = form, state
        self.written: list[bytes] = []
        self.handler: Callable[[bytes], bytes] = lambda body: body
        self.arrived = asyncio.Event()

    def set(self, state: bytes) -> None:
        """Another state; observers are told."""
        self.state = state
        self.updated_state()

    async def needs_blockwise_assembly(self, request: Message) -> bool:
        """Blocks of an answer are made here: aiocoap makes none of an observed one."""
        return bool(request.code != aiocoap.GET)

    async def render_get(self, request: Message) -> Message:
        """The state, or a block of it."""
        if request.opt.block2 is None and len(self.state) <= MAX_BLOCK:
            return Message(payload=self.state, content_format=self.form)
        number = 0 if request.opt.block2 is None else request.opt.block2.block_number
        begin, end = number * MAX_BLOCK, (number + 1) * MAX_BLOCK
        block = BlockOption.BlockwiseTuple(number, end < len(self.state), 6)
        return Message(payload=self.state[begin:end], content_format=self.form, block2=block)

    async def render_put(self, request: Message) -> Message:
        """Write it."""
        self.written.append(bytes(request.payload))
        self.arrived.set()
        return Message(code=aiocoap.CHANGED)

    async def render_post(self, request: Message) -> Message:
        """Call it."""
        self.written.append(bytes(request.payload))
        self.arrived.set()
        return Message(
            code=aiocoap.CHANGED, payload=self.handler(bytes(request.payload)), content_format=self.form
        )


class LinkList(resource.Resource):  # type: ignore[misc]
    """The list of resources."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text

    async def render_get(self, request: Message) -> Message:
        """The list."""
        return Message(payload=self.text.encode(), content_format=40)


class _Thing:
    """What both classes share."""

    def __init__(self, border: tuple[str, int], links: str, own: str = "::1") -> None:
        self.border, self.own = border, own
        self.site = resource.Site()
        self.links = LinkList(links)
        self.site.add_resource(LINKS, self.links)
        self.known = credentials.CredentialsMap()
        self.context: aiocoap.Context
        self.port = 0

    @property
    def uri(self) -> str:
        """The border router."""
        host, port = self.border
        return f"coap://[{host}]:{port}" if ":" in host else f"coap://{host}:{port}"

    def add(self, path: str, value: Value) -> Value:
        """A resource."""
        self.site.add_resource(path.strip("/").split("/"), value)
        return value

    async def start(self) -> None:
        """Listen on a port of its address."""
        self.port = self.port or free_port()
        self.context = await aiocoap.Context.create_server_context(
            OscoreSiteWrapper(self.site, self.known),
            bind=(self.own, self.port),
            transports=["oscore", "udp6"],
        )

    async def close(self) -> None:
        """Stop, as if the power failed: nothing is said to the router."""
        await asyncio.sleep(0.05)  # else aiocoap leaves coroutines that it has just made
        await self.context.shutdown()

    async def __aenter__(self) -> Any:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


class Thing(_Thing):
    """A thing with a key."""

    def __init__(
        self,
        border: tuple[str, int],
        peer: ThingKey,
        links: str,
        kid: bytes = b"\x2c",
        key: ec.EllipticCurvePrivateKey | None = None,
        own: str = "::1",
    ) -> None:
        super().__init__(border, links, own)
        self.key = key or ec.generate_private_key(ec.SECP256R1())
        self.credential = ThingKey.of(self.key.public_key(), kid)
        self.peer = peer
        self._remote: Any = None
        self.combined = True

    async def register(self, code: Code = aiocoap.POST, path: str = "rd") -> Code:
        """Say that it is there; with a handshake the first time."""
        request = aiocoap.Message(code=code, uri=f"{self.uri}/{path}")
        if self._remote is None:
            self._handshake()
        else:
            request = aiocoap.Message(code=code, uri_path=[path])
            request.remote = self._remote
        response = await self.context.request(request).response
        self._take(response.remote)
        return Code(response.code)

    def forget(self) -> None:
        """Forget the context."""
        self._remote = None
        self.known.pop(":border", None)

    def _handshake(self) -> None:
        private = self.key.private_numbers().private_value.to_bytes(32)
        self.context.client_credentials[f"{self.uri}/*"] = EdhocCredentials(
            suite=2,
            method=3,
            own_cred_style="by-key-id",
            own_cred={14: cbor2.loads(self.credential.ccs)},
            private_key={1: 2, -1: 1, -4: private},
            peer_cred={14: cbor2.loads(self.peer.ccs)},
            use_combined_edhoc=self.combined,
        )

    def _take(self, remote: Any) -> None:
        """Serve the router's requests in the context of the thing's own."""
        if not isinstance(remote, OSCOREAddress):
            return
        self._remote, context = remote, remote.security_context
        context.get_oscore_context_for = lambda found: (
            context if found.get(oscore.COSE_KID) == context.recipient_id else None
        )
        context.find_all_used_contextless_oscore_kid = lambda: {context.recipient_id}
        context.authenticated_claims = []
        self.known[":border"] = context


class SecretThing(_Thing):
    """A thing with a secret."""

    def __init__(self, border: tuple[str, int], secret: bytes, links: str, kid: bytes = b"\x07") -> None:
        super().__init__(border, links)
        self.secret, self.kid = secret, kid
        self._oscore: Any = None

    async def register(self, code: Code = aiocoap.POST, path: str = "rd") -> Code:
        """Say that it is there; derives a context the first time, and when the router lost it."""
        if self._oscore is None:
            await self._derive()
        request = aiocoap.Message(code=code, uri_path=[path])
        identifier, answer = await self._ask(self._oscore, request, self._wanted)
        opened, _ = self._oscore.open(answer, identifier)
        return Code(opened.code)

    def forget(self) -> None:
        """Forget the context."""
        self._oscore = None
        self.known.pop(":border", None)

    async def _derive(self) -> None:
        first = secrets.token_bytes(NONCE_SIZE)
        context = thing_context(self.secret, self.kid, first)
        request = aiocoap.Message(code=aiocoap.POST, uri_path=["rd"])
        identifier, answer = await self._ask(context, request, wrapped(first))
        value = unwrapped(_kid_context(answer))
        assert len(value) == R2_SIZE
        second = thing_context(self.secret, self.kid, value + first)
        second.open(answer, identifier)  # it is the router's
        third = value + secrets.token_bytes(NONCE_SIZE)
        self._wanted = wrapped(third)
        self._oscore = thing_context(self.secret, self.kid, third)
        self._oscore.get_oscore_context_for = lambda found: (
            self._oscore if found.get(oscore.COSE_KID) == self._oscore.recipient_id else None
        )
        self._oscore.find_all_used_contextless_oscore_kid = lambda: {b""}
        self.known[":border"] = self._oscore

    async def _ask(self, context: Any, request: Message, kid_context: bytes) -> Any:
        sealed, identifier = context.seal(request)

        name_context(sealed, kid_context)
        host, port = self.border
        sealed.set_request_uri(f"coap://[{host}]:{port}", set_uri_host=False)
        answer = await self.context.request(sealed, handle_blockwise=False).response
        return identifier, answer


def _kid_context(answer: Message) -> bytes:
    _, _, found, _ = oscore.CanUnprotect._extract_encrypted0(answer)
    value = found.get(oscore.COSE_KID_CONTEXT)
    assert isinstance(value, bytes)
    return value
