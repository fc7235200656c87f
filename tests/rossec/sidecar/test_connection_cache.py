"""Cached connections: for one caller, for a few seconds."""

import asyncio
from typing import Any

import pytest

from rossec.channel.opening import WireProtocol
from rossec.sidecar import server
from rossec.sidecar.core.layers import ListeningAddress
from rossec.sidecar.server import ConnectionCache
from tests.support.witness import until

ENDPOINT = ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)


class FakeClient:
    """Stands for a slave API client and its RPC client."""

    def __init__(self) -> None:
        self.rpc = self
        self.closed = False

    async def close(self) -> None:
        self.closed = True


async def test_a_cached_connection_is_taken_once() -> None:
    cache, one = ConnectionCache(), FakeClient()
    cache.put(ENDPOINT, _as(one))
    assert cache.take(ENDPOINT) == _as(one)
    assert cache.take(ENDPOINT) is None
    await cache.close()
    assert not one.closed, "it is the caller's now"


async def test_an_older_connection_is_closed() -> None:
    cache, old, new = ConnectionCache(), FakeClient(), FakeClient()
    cache.put(ENDPOINT, _as(old))
    cache.put(ENDPOINT, _as(new))
    await until(lambda: old.closed)
    assert not new.closed
    assert cache.take(ENDPOINT) == _as(new)
    await cache.close()


async def test_a_cached_connection_is_closed_after_its_lifetime(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "LIFETIME", 0.0)
    cache, one, other = ConnectionCache(), FakeClient(), FakeClient()
    cache.put(ENDPOINT, _as(one))
    await until(lambda: one.closed)
    assert cache.take(ENDPOINT) is None
    cache.put(ENDPOINT, _as(other))
    assert cache.take(ENDPOINT) == _as(other)
    await asyncio.sleep(0.01)
    assert not other.closed
    await cache.close()


def _as(client: FakeClient) -> Any:
    return client
