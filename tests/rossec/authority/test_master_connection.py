"""A connection to the master for a few calls."""

import pytest

from rossec.authority.master_connection import master_connection
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.errors import ConfigurationError
from tests.support.site import Site


async def test_a_call_reaches_the_master(site: Site) -> None:
    home = site.enroll("/looker")
    uri = site.environ["ROS_MASTER_URI"]
    async with master_connection(home.credentials(), home.anchor(), uri, OFFERED_SUITES) as client:
        assert await client.ask("getPid", home.name)


async def test_another_node_there_is_refused(site: Site) -> None:
    home = site.enroll("/looker")
    async with site.node("/robot") as robot:
        connection = master_connection(home.credentials(), home.anchor(), robot.uri, OFFERED_SUITES)
        with pytest.raises(ConfigurationError, match="/robot answers there"):
            async with connection:
                pass


async def test_what_is_no_uri_is_refused(site: Site) -> None:
    home = site.enroll("/looker")
    connection = master_connection(home.credentials(), home.anchor(), "nowhere", OFFERED_SUITES)
    with pytest.raises(ConfigurationError, match="the master's URI"):
        async with connection:
            pass
