from dataclasses import dataclass

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import ConfigurationError
from rossec.host.local_ports import PortPool
from rossec.sidecar.core.layers import ListeningAddress, local_endpoint


@dataclass
class FakePort:
    connections: int = 0


ENDPOINTS = [local_endpoint(WireProtocol.HTTP, port) for port in range(1, 6)]


def test_the_least_recently_requested_idle_port_is_evicted() -> None:
    closed: list[ListeningAddress] = []
    pool = PortPool[ListeningAddress, FakePort](lambda endpoint, _: closed.append(endpoint), limit=3)
    first, second, _ = (pool.get_or_open(endpoint, FakePort) for endpoint in ENDPOINTS[:3])
    assert pool.get_or_open(ENDPOINTS[0], FakePort) is first
    second.connections = 1
    fourth = pool.get_or_open(ENDPOINTS[3], FakePort)
    assert closed == [ENDPOINTS[2]]
    assert pool.get(ENDPOINTS[2]) is None
    assert list(pool) == [second, first, fourth]


def test_only_ports_that_may_be_evicted_are_evicted() -> None:
    """An idle live program keeps its port: the master has its address."""
    closed: list[ListeningAddress] = []
    dead = {ENDPOINTS[1]}
    pool = PortPool[ListeningAddress, FakePort](
        lambda endpoint, _: closed.append(endpoint), dead.__contains__, limit=3
    )
    for endpoint in ENDPOINTS[:4]:
        pool.get_or_open(endpoint, FakePort)
    assert closed == ENDPOINTS[1:2]
    with pytest.raises(ConfigurationError):
        pool.get_or_open(ENDPOINTS[4], FakePort)


def test_ports_in_use_are_not_evicted() -> None:
    pool = PortPool[ListeningAddress, FakePort](lambda *_: pytest.fail("closed one in use"), limit=2)
    for endpoint in ENDPOINTS[:2]:
        pool.get_or_open(endpoint, lambda: FakePort(1))
    with pytest.raises(ConfigurationError, match="more than 2 addresses") as caught:
        pool.get_or_open(ENDPOINTS[2], FakePort)
    assert "identity" in caught.value.hint
