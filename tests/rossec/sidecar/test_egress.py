"""Loopback ports for peers: what programs receive, and what not."""

from grants.model import Restriction, Right, filter_rules
from tests.rossec.sidecar.program import string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes


async def test_messages_of_a_restricted_publisher_are_filtered_on_receipt(
    pair: SidecarPair,
) -> None:
    """Its own sidecar sends everything; the subscriber's sidecar applies the restriction."""
    for file in pair.site.enroll("/talker").path.glob("grants/*"):
        file.unlink()
    rules = filter_rules({"data": {"truncate": {"length": 2}}})
    restriction = Restriction("std_msgs/String", ('msg.data != "stop"',), rules)
    pair.site.grant("/talker", Right.PUBLISH, "/word", restriction=restriction)
    stream, source = await connect(pair)
    await source.send(string_message("hello") + string_message("stop") + string_message("world"))
    expected = string_message("he") + string_message("wo")
    assert await receive_bytes(stream, len(expected)) == expected
