"""The authority's service waits for requests of identities; a locked one does not."""

import asyncio
import time
from pathlib import Path

import pytest

from rossec.authority.signing import OWN_NODE
from rossec.master.server import answers
from rossec.ros.names import WATCH_RENEWALS
from tests.support.caller import caller
from tests.support.site import Site


async def test_a_service_waits_unless_it_is_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers, "RENEWALS_WAIT", 60.0)
    site = Site(tmp_path / "site")
    async with site.running(), caller(site, OWN_NODE) as service:
        code, _, nothing = await service(WATCH_RENEWALS, 1)
        assert code == 1
        waiting = asyncio.ensure_future(service(WATCH_RENEWALS, 0))
        await asyncio.sleep(0.1)
        assert not waiting.done()
        assert site.master is not None
        site.master.state.renewal_changes.notify()
        began = time.monotonic()
        assert (await waiting)[2] == nothing
        assert time.monotonic() - began < 50
