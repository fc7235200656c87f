"""A ROS node that needs no ROS: `async with Node("/camera") as node: ...`.

What is exported here is imported on first use: message classes and arrays take more memory than all
the rest, and a sidecar, which shares this package's rules, never looks at a message.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rossec.node.client import ServiceClient
    from rossec.node.messages import message_type, register_type
    from rossec.node.node import Node
    from rossec.node.provider import Service
    from rossec.node.publisher import Publisher
    from rossec.node.srvtypes import register_service_type, service_type
    from rossec.node.subscriber import Subscriber

__all__ = [
    "Node",
    "Publisher",
    "Service",
    "ServiceClient",
    "Subscriber",
    "message_type",
    "register_service_type",
    "register_type",
    "service_type",
]

_PLACES: Final = {
    "Node": "node",
    "Publisher": "publisher",
    "Service": "provider",
    "ServiceClient": "client",
    "Subscriber": "subscriber",
    "message_type": "messages",
    "register_service_type": "srvtypes",
    "register_type": "messages",
    "service_type": "srvtypes",
}


def __getattr__(name: str) -> object:
    """Import what is exported (PEP 562)."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
