"""A ROS node that needs no ROS: `async with Node("/camera") as node: ...`."""

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
