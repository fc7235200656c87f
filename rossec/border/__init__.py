"""The border router of constrained things. Reserved: nothing is here yet."""

from rossec.border.border_router import BorderRouter
from rossec.border.handshakes import StaticKey

__all__ = ["BorderRouter", "StaticKey"]
