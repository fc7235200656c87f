from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from tests.rossec.sidecar.conversation import Pair
from tests.rossec.sidecar.playbook import Stage
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.site import Site


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    site = Site(tmp_path / "site")
    site.enroll("/viewer")
    return Stage(site)


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[Pair]:
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
        yield Pair(site, near, far, talker, listener)
