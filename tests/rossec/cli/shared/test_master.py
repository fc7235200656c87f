from dataclasses import replace
from pathlib import Path

import pytest

from rossec.channel.opening import WireProtocol
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import master_as, master_at
from rossec.errors import ConfigurationError
from rossec.net.bounds import DIALLED
from tests.support.site import Site


def test_the_masters_uri_is_the_given_one_then_that_of_the_environment() -> None:
    environment = Environment({"ROS_MASTER_URI": "http://m:1"})
    assert master_at(environment, "http://given:2") == "http://given:2"
    assert master_at(environment) == "http://m:1"
    assert master_at(Environment({})) == "http://localhost:11311"


async def test_a_call_reaches_the_master(site: Site) -> None:
    home = site.enroll("/looker")
    environment = Environment(site.environ)
    async with master_as(environment, home, master_at(environment)) as client:
        assert await client.ask("getPid", home.name)


async def test_another_node_at_the_masters_address_is_refused(site: Site) -> None:
    home = site.enroll("/looker")
    async with site.node("/robot") as robot:
        with pytest.raises(ConfigurationError, match="/robot answers there"):
            async with master_as(Environment(site.environ), home, robot.uri):
                pass


async def test_how_long_a_call_may_be_is_up_to_the_master(tmp_path: Path) -> None:
    site, length = Site(tmp_path / "site"), DIALLED[WireProtocol.HTTP].unit + 1
    site.limits = replace(site.limits, body=2 * length)
    home = site.enroll("/looker")
    async with site.running():
        environment = Environment(site.environ)
        async with master_as(environment, home, master_at(environment)) as client:
            answer = await client.call("setParam", home.name, "/p", bytes(length))
            assert isinstance(answer, list)
            assert answer[0] == -1, "refused for want of a grant, not for its length"
