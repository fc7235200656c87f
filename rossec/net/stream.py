"""Secure streams for asyncio: `connect`, `serve`, and the `SecureStream` both hand out."""

from rossec.channel.opening import Flavour
from rossec.net.client import connect
from rossec.net.halfopen import HalfOpen
from rossec.net.secure import SecureStream
from rossec.net.server import SecureServer, serve

__all__ = ["Flavour", "HalfOpen", "SecureServer", "SecureStream", "connect", "serve"]
