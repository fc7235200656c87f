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
        sidecar(site) as talker_sidecar,
        sidecar(site) as listener_sidecar,
        Program("/talker", talker_sidecar) as talker,
        Program("/listener", listener_sidecar) as listener,
    ):
        yield SidecarPair(site, talker_sidecar, listener_sidecar, talker, listener)
