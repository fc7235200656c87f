"""A ROS node that needs no ROS: `async with Node("/camera") as node: ...`.

Exports are imported on first use: message classes and arrays take more memory than all the rest.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rossec.node.node import Node
    from rossec.node.publisher import Publisher
    from rossec.node.service import Service
    from rossec.node.service_client import ServiceClient
    from rossec.node.subscriber import Subscriber
    from rossec.participant.message_types import message_type, register_type
    from rossec.participant.service_types import register_service_type, service_type

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

_MODULES: Final = {
    "Node": "rossec.node.node",
    "Publisher": "rossec.node.publisher",
    "Service": "rossec.node.service",
    "ServiceClient": "rossec.node.service_client",
    "Subscriber": "rossec.node.subscriber",
    "message_type": "rossec.participant.message_types",
    "register_service_type": "rossec.participant.service_types",
    "register_type": "rossec.participant.message_types",
    "service_type": "rossec.participant.service_types",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
