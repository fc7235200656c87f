"""What a raw subscriber takes from publishers, of any type and as bytes, with a real master."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from grants.model import Restriction, Right, filter_rules
from rossec.errors import ConnectionHeaderRefused
from rossec.node.subscriber import RawSource, claimed
from rossec.participant.definitions import Definition
from rossec.participant.message_types import message_type
from tests.support.site import Site
from tests.support.witness import until

TYPE = "std_msgs/String"
MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"


class Receiver:
    """Notes what it is told; refuses sources that latch, if told so."""

    def __init__(self, *, refuse_latching: bool = False) -> None:
        self.refuse_latching = refuse_latching
        self.sources: list[RawSource] = []
        self.gone: list[RawSource] = []
        self.messages: list[tuple[RawSource, bytes]] = []
        self.errors: list[Exception] = []

    def connected(self, source: RawSource) -> None:
        if self.refuse_latching and source.latching:
            raise ConnectionHeaderRefused("no latching one")
        self.sources.append(source)

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        self.messages += [(source, message) for message in messages]

    def disconnected(self, source: RawSource) -> None:
        self.gone.append(source)

    def refused(self, error: Exception) -> None:
        self.errors.append(error)


async def test_messages_come_as_bytes_with_the_type_of_their_publisher(site: Site) -> None:
    site.publish("/robot", "/said")
    site.subscribe("/box", "/said")
    receiver = Receiver()
    async with site.node("/robot") as robot, site.node("/box") as box:
        subscriber = await box.topics.subscribe_raw("/said", receiver)
        publisher = await robot.publisher("/said", TYPE, latch=True)
        publisher.publish(publisher.create(data="hello"))
        await until(lambda: len(receiver.messages) == 1, within=20)
        source, data = receiver.messages[0]
        assert data == b"\x05\0\0\0hello"
        string = message_type(TYPE)
        assert source.type == Definition(TYPE, string.md5sum, string.definition)
        assert (source.peer, source.latching) == ("/robot", True)
        await subscriber.close()
        assert receiver.gone == receiver.sources == [source]
    assert receiver.errors == []


async def test_a_source_that_is_refused_is_gone_without_a_message(site: Site) -> None:
    site.publish("/robot", "/said")
    site.subscribe("/box", "/said")
    receiver = Receiver(refuse_latching=True)
    async with site.node("/robot") as robot, site.node("/box") as box:
        await box.topics.subscribe_raw("/said", receiver)
        publisher = await robot.publisher("/said", TYPE, latch=True)
        publisher.publish(publisher.create(data="hello"))
        await until(lambda: len(receiver.errors) >= 2, within=20)
    assert str(receiver.errors[0]) == "no latching one"
    assert (receiver.sources, receiver.gone, receiver.messages) == ([], [], [])


async def test_the_restrictions_of_a_publisher_hold_by_the_definition_of_this_host(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    rules = filter_rules({"data": {"truncate": {"length": 4}}})
    site.grant("/boss", Right.PUBLISH, "/order", restriction=Restriction(TYPE, (), rules))
    site.subscribe("/box", "/order")
    receiver = Receiver()
    async with site.running(), site.node("/boss") as boss, site.node("/box") as box:
        await box.topics.subscribe_raw("/order", receiver)
        publisher = await boss.publisher("/order", TYPE, latch=True)
        publisher.publish(publisher.create(data="go on"))
        await until(lambda: len(receiver.messages) == 1, within=20)
    assert receiver.messages[0][1] == b"\x04\0\0\0go o"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"type": b"*"}, "no type"),
        ({"md5sum": b"*"}, "no type"),
        ({"type": b"String"}, "no type"),
        ({"md5sum": b"992C" + b"0" * 28}, "no type"),
        ({"message_definition": b"x" * 262_145}, "262145 characters"),
    ],
)
def test_a_publisher_that_does_not_say_its_type_is_refused(changes: dict[str, bytes], reason: str) -> None:
    fields = {"type": TYPE.encode(), "md5sum": MD5.encode(), "message_definition": b"string data"}
    assert claimed(fields).name == TYPE
    with pytest.raises(ConnectionHeaderRefused, match=reason):
        claimed(fields | changes)
