"""Connections are counted by what limits them together: one key, or a foreign domain."""

from typing import Any

from rossec.master.server.effects import CallerConnections
from rossec.net.rpc import source_of
from tests.support.authority import Site


def test_a_group_is_what_has_one_key() -> None:
    site, connections = Site(), CallerConnections()
    first, second = site.enroll("/a").identity, site.enroll("/b").identity
    streams: list[Any] = [_Stream(peer) for peer in (first, first, second)]
    for stream in streams:
        connections.add(stream)
        connections.add(stream)
    assert len(connections) == 3
    assert connections.of_group(source_of(first).group) == [first, first]
    for stream in streams[:2]:
        connections.discard(stream)
        connections.discard(stream)
    assert connections.of_group(source_of(first).group) == []
    assert list(connections) == streams[2:]
    assert len(connections._by_group) == 1, "a group without a connection takes no memory"


class _Stream:
    def __init__(self, peer: object) -> None:
        self.peer = peer
