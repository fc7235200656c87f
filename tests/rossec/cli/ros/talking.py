"""A site with one node that talks, for commands that look at its topics."""

import asyncio
import contextlib

from grants.model import Right
from rossec.node import Node, register_type
from tests.support.site import Site

STRING = "std_msgs/String"
WORDS = "words_msgs/Words"


async def talk(node: Node) -> None:
    """Publish at 20 Hz until the node ends: text, and a type that only this program knows."""
    words = register_type(WORDS, "string[] words\nstd_msgs/String one\n")
    chatter = await node.publisher("/chatter", STRING)
    own = await node.publisher("/words", WORDS)
    first, second = chatter.endpoint.type.create(data="hello"), words.create(words=["a", "b"])

    async def repeat() -> None:
        with contextlib.suppress(Exception):
            while True:
                chatter.publish(first)
                own.publish(second)
                await asyncio.sleep(0.05)

    node_tasks.append(asyncio.ensure_future(repeat()))


node_tasks: list[asyncio.Task[None]] = []


def prepare(site: Site) -> None:
    site.publish("/talker", "/chatter")
    site.publish("/talker", "/words")
    for topic in ("/chatter", "/words", "/silent"):
        site.subscribe("/listener", topic)
    site.grant("/observer", Right.GRAPH, "/**")
    site.enroll("/eve")
