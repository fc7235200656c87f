"""Secure streams for asyncio: `connect`, `serve`, and the `SecureStream` both return."""

from rossec.channel.opening import WireProtocol
from rossec.net.aio.client import as_master, connect
from rossec.net.aio.server import SecureServer, serve
from rossec.net.aio.stream import SecureStream
from rossec.net.context import SecureContext

__all__ = ["SecureContext", "SecureServer", "SecureStream", "WireProtocol", "as_master", "connect", "serve"]
