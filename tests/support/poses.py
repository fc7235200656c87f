"""Topics of poses between the nodes of a site: publish, receive, revoke."""

import asyncio
from typing import Any, Final

from ca.revocation.lists import is_tree
from rossec.node import Node, Publisher, Subscriber
from tests.support.site import Site

POSE: Final = "geometry_msgs/PoseStamped"


async def first(subscriber: Subscriber, within: float = 30.0) -> Any:
    async with asyncio.timeout(within):
        return await anext(aiter(subscriber))


def pose(publisher: Publisher, x: float = 3.3, frame: str = "map") -> Any:
    message = publisher.create()
    message.pose.position.x, message.header.frame_id = x, frame
    return message


async def tell_master(site: Site, node: Node, revocations: bytes) -> None:
    if is_tree(revocations):
        await node._membership.session.call("rossec.updateRevocationTree", revocations, site.entries)
    else:
        await node._membership.session.call("rossec.updateRevocations", revocations)
