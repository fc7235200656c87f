"""What every attack runs against: a site with a master, and an honest pair of nodes."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.attacker import listen
from tests.support.site import Site
from tests.support.witness import Witness, undisturbed


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


@pytest.fixture
async def witness(site: Site, caplog: pytest.LogCaptureFixture) -> AsyncIterator[Witness]:
    listen(caplog)
    async with undisturbed(site) as witness:
        yield witness
