from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from tests.rossec.sidecar.agent_setup import AgentSetup
from tests.rossec.sidecar.program import Program, sidecar
from tests.rossec.sidecar.sidecar_pair import SidecarPair
from tests.support.site import Site


@pytest.fixture
def setup(tmp_path: Path) -> AgentSetup:
    site = Site(tmp_path / "site")
    site.enroll("/viewer")
    return AgentSetup(site)


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[SidecarPair]:
    site = Site(tmp_path / "site")
    site.publish("/talker", "/word")
    site.grant("/talker", Right.PROVIDE, "/say")
    site.subscribe("/listener", "/word")
    site.grant("/listener", Right.CALL, "/say")
    async with (
        site.running(),
        sidecar(site) as near,
        sidecar(site) as far,
        Program("/talker", near) as talker,
        Program("/listener", far) as listener,
    ):
        yield SidecarPair(site, near, far, talker, listener)
