"""A trust state with an empty revocation list, and a master with a victim."""

import pytest

from rossec.master.api.dispatch import MasterApi
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, everything, master_api
from tests.rossec.master.rights.trust_world import World
from tests.rossec.master.rights.victim import VICTIM_API, T, ask


@pytest.fixture
def world() -> World:
    world = World()
    assert world.trust.update(world.site.revoke(), world.now)
    return world


@pytest.fixture
def api() -> MasterApi:
    """A master at which the victim publishes, subscribes and provides."""
    api = master_api(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)
    victim = everything("/victim")
    for call in (
        ("registerPublisher", "/victim", "/secret", T, VICTIM_API),
        ("registerSubscriber", "/victim", "/cmd_vel", T, VICTIM_API),
        ("registerService", "/victim", "/arm", "rosrpc://victim:2", VICTIM_API),
    ):
        assert ask(api, victim, *call)[0] == 1
    return api
