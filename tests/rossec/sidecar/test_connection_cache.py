"""Connections kept for who comes next: for one caller, and for a moment."""

import asyncio
from typing import Any

import pytest

from rossec.channel.opening import WireProtocol
from rossec.sidecar import connection_cache
from rossec.sidecar.connection_cache import ConnectionCache
from rossec.sidecar.core.endpoints import Endpoint
from tests.support.witness import until

PLACE = Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)


class Kind:
    """Stands for a correspondent and its client."""

    def __init__(self) -> None:
        self.client = self
        self.closed = False

    async def close(self) -> None:
        self.closed = True


async def test_for_one_caller_alone() -> None:
    shelf, one = ConnectionCache(), Kind()
    shelf.keep(PLACE, _as(one))
    assert shelf.take(PLACE) == _as(one)
    assert shelf.take(PLACE) is None
    await shelf.close()
    assert not one.closed, "it is the caller's now"


async def test_the_older_one_is_let_go() -> None:
    shelf, old, new = ConnectionCache(), Kind(), Kind()
    shelf.keep(PLACE, _as(old))
    shelf.keep(PLACE, _as(new))
    await until(lambda: old.closed)
    assert not new.closed
    assert shelf.take(PLACE) == _as(new)
    await shelf.close()


async def test_for_a_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_cache, "_KEEP", 0.0)
    shelf, one, other = ConnectionCache(), Kind(), Kind()
    shelf.keep(PLACE, _as(one))
    await until(lambda: one.closed)
    assert shelf.take(PLACE) is None
    shelf.keep(PLACE, _as(other))
    assert shelf.take(PLACE) == _as(other)
    await asyncio.sleep(0.01)
    assert not other.closed
    await shelf.close()


def _as(kind: Kind) -> Any:
    return kind
