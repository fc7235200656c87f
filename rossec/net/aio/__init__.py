"""Secure streams for asyncio: `connect`, `serve`, and the `SecureStream` both hand out."""

from rossec.channel.opening import Flavour
from rossec.net.aio.client import connect
from rossec.net.aio.server import SecureServer, serve
from rossec.net.aio.stream import SecureStream
from rossec.net.halfopen import HalfOpen

__all__ = ["Flavour", "HalfOpen", "SecureServer", "SecureStream", "connect", "serve"]
