"""A ROS node that needs no ROS: `async with Node("/camera") as node: ...`."""

from rossec.node.messages import message_type, register_type
from rossec.node.node import Node
from rossec.node.publisher import Publisher
from rossec.node.subscriber import Subscriber

__all__ = ["Node", "Publisher", "Subscriber", "message_type", "register_type"]
