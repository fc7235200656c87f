"""A full disk of the master does not prevent a revocation."""

import pytest

from ca.errors import HintedError
from rossec.ros.names import MASTER
from tests.rossec.test_files import no_room
from tests.support.attacker import EVE, call, credentials
from tests.support.site import Site
from tests.support.witness import until


@pytest.mark.attack("full-disk")
async def test_a_key_is_revoked_although_the_masters_disk_is_full(site: Site) -> None:
    assert site.master is not None
    eve, carrier, home = credentials(site), credentials(site, "/carrier"), site.enroll(MASTER)
    uri = site.master.uri

    async def serves() -> bool:
        try:
            answer = await call(uri, eve, "getUri", EVE)
        except (HintedError, OSError):
            return False
        return isinstance(answer, list) and answer[0] == 1

    assert await serves()
    data = site.revoke(site.identity(EVE).thumbprint)
    with no_room():
        answer = await call(uri, carrier, "rossec.updateRevocations", "/carrier", data)
        assert answer == [1, "revocations updated", 1]
        assert home.load_revocations() != data
        assert not await serves()
    await until(lambda: home.load_revocations() == data, within=40)  # there is room again
