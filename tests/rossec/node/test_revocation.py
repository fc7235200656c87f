"""A parameter subscription receives no updates after its grant is revoked."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from rossec.master.state.registry import Kind
from tests.support.poses import tell_master
from tests.support.site import Site
from tests.support.witness import until


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


async def test_a_parameter_subscription_ends_with_its_grant(site: Site) -> None:
    right = site.grant("/reader", Right.PARAM_GET, "/speed")
    site.grant("/writer", Right.PARAM_SET, "/speed")
    assert site.master is not None
    registry = site.master.state.registry
    async with site.node("/reader") as reader, site.node("/writer") as writer:
        await reader._membership.session.call("subscribeParam", reader.uri, "/speed")
        assert registry.registered_nodes(Kind.PARAMETER, "/speed/") != ()
        await tell_master(site, writer, site.revoke(right))
        await until(lambda: registry.registered_nodes(Kind.PARAMETER, "/speed/") == (), within=20)
        await writer._membership.session.call("setParam", "/speed", 3)
