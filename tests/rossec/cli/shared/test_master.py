from dataclasses import replace
from pathlib import Path

import pytest

from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import (
    calls_as,
    find_master,
    is_of_revoked,
    master_as,
    master_at,
    node_as,
    own_variables,
    with_master,
)
from rossec.errors import ChannelClosed, ConfigurationError, MasterNotFound
from rossec.ros.xmlrpc import Fault
from tests.support.attacker import call, credentials
from tests.support.discovered import FOUND, Searches
from tests.support.site import Site


def test_the_masters_uri_is_the_given_one_then_that_of_the_environment() -> None:
    environment = Environment({"ROS_MASTER_URI": "http://m:1"})
    assert master_at(environment, None, "http://given:2") == "http://given:2"
    assert master_at(environment, None) == "http://m:1"
    assert master_at(Environment({}), None) == "http://localhost:11311"


async def test_the_master_is_found_once_for_a_command(site: Site, searches: Searches) -> None:
    home = site.enroll("/looker")
    environment = Environment({**site.environ, "ROS_MASTER_URI": "discover:"})
    assert await find_master(environment, home) == FOUND
    assert (await with_master(environment, "looker"))["ROS_MASTER_URI"] == FOUND
    assert await find_master(environment, None) == FOUND
    assert len(searches.made) == 1, "one authority, one search"
    assert await find_master(environment, None, "http://given:2") == "http://given:2"
    configured = Environment({**site.environ, "ROS_MASTER_URI": "http://m:1"})
    assert await find_master(configured, home, "discover:") == FOUND


def test_the_search_begins_where_there_is_no_loop(tmp_path: Path, searches: Searches) -> None:
    site = Site(tmp_path / "site")
    home = site.enroll("/looker")
    assert master_at(Environment({"ROSSEC_HOME": str(site.root)}), home, "discover:") == FOUND


async def test_a_search_in_vain_is_not_repeated(site: Site, searches: Searches) -> None:
    searches.result = MasterNotFound("no master announces itself")
    environment = Environment({**site.environ, "ROS_MASTER_URI": "discover:"})
    site.enroll("/looker")
    for name in ("/looker", None):
        with pytest.raises(MasterNotFound, match="announces"):
            await find_master(environment, name)
    assert len(searches.made) == 1


async def test_a_node_runs_with_the_master_that_was_found(site: Site, searches: Searches) -> None:
    searches.result = site.environ["ROS_MASTER_URI"]
    site.enroll("/looker")
    async with node_as(Environment({**site.environ, "ROS_MASTER_URI": "discover:"}), "/looker") as node:
        assert node.settings.master_uri == site.environ["ROS_MASTER_URI"]


def test_a_master_listens_where_ros_expects_it_if_others_discover_it() -> None:
    found = own_variables(Environment({"ROS_MASTER_URI": "discover:", "ROS_IP": "127.0.0.1"}))
    assert found == {"ROS_MASTER_URI": "http://localhost:11311", "ROS_IP": "127.0.0.1"}
    assert own_variables(Environment({"ROS_MASTER_URI": "http://m:1"})) == {"ROS_MASTER_URI": "http://m:1"}


async def test_a_call_reaches_the_master(site: Site) -> None:
    home = site.enroll("/looker")
    environment = Environment(site.environ)
    async with master_as(environment, home, await find_master(environment, home)) as client:
        assert await client.ask("getPid", home.name)


async def test_another_node_at_the_masters_address_is_refused(site: Site) -> None:
    home = site.enroll("/looker")
    async with site.node("/robot") as robot:
        with pytest.raises(ConfigurationError, match="/robot answers there"):
            async with master_as(Environment(site.environ), home, robot.uri):
                pass


async def test_how_long_a_call_may_be_is_up_to_the_master(tmp_path: Path) -> None:
    site, length = Site(tmp_path / "site"), 2 * 1024 * 1024
    home = site.enroll("/looker")
    site.subscribe("/looker", "/pose")
    for limits, said in ((site.limits, "needs the right"), (replace(site.limits, body=length), "")):
        site.limits = limits
        async with site.running():
            environment = Environment(site.environ)
            uri = await find_master(environment, home)
            async with master_as(environment, home, uri) as client:
                await client.ask("rossec.presentGrants", home.name, home.grants())
                if said:
                    answer = await client.call("setParam", home.name, "/p", bytes(length))
                    assert said in str(answer), "refused for want of a grant, not for its length"
                else:
                    with pytest.raises(Fault):
                        await client.call("setParam", home.name, "/p", bytes(length))


async def test_grants_are_presented_before_a_call(site: Site) -> None:
    site.subscribe("/looker", "/pose")
    home = site.enroll("/looker")
    environment = Environment(site.environ)
    async with calls_as(environment, home, await find_master(environment, home)) as call:
        state = await call("getSystemState")
        assert await call("registerSubscriber", "/pose", "*", "http://127.0.0.1:1/") == []
    assert state == [[], [], []]


async def test_a_revoked_identity_is_said_to_be_revoked(site: Site) -> None:
    """The master closes the connection at its first call, which alone would say nothing."""
    site.subscribe("/looker", "/pose")
    home, own = site.enroll("/looker"), credentials(site, "/carrier")
    environment = Environment(site.environ)
    data = site.revoke(site.identity("/looker").thumbprint)
    uri = await find_master(environment, home)
    await call(uri, own, "rossec.updateRevocations", "/carrier", data)
    with pytest.raises(ConfigurationError, match="identity is revoked: /looker") as raised:
        async with calls_as(environment, home, uri) as ask:
            await ask("getSystemState")
    assert "rossec node request /looker" in raised.value.hint


async def test_a_connection_that_is_closed_for_another_reason_is_said_to_be_closed(site: Site) -> None:
    home = site.enroll("/looker")
    environment = Environment(site.environ)
    with pytest.raises(ChannelClosed):
        async with master_as(environment, home, await find_master(environment, home)):
            raise ChannelClosed("the peer closed the connection")


@pytest.mark.parametrize("answer", [[b"", b""], [b"x", b"t"], [], "x", [b"x"], [b"x", b"", b""]])
def test_what_a_node_in_good_order_is_answered(answer: object) -> None:
    assert not is_of_revoked(answer)
    assert is_of_revoked([b"list", b""])
