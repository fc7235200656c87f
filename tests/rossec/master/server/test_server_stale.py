"""A foreign master of whose domain nothing is known yet is told the own revocations."""

from pathlib import Path

import pytest

from rossec.errors import RossecError
from rossec.net.rpc.calls import RpcClient
from tests.support.attacker import credentials, dial
from tests.support.site import Site
from tests.support.trust import accept, carry


async def test_a_stale_foreign_master_is_told_the_own_revocations(tmp_path: Path) -> None:
    home, hospital = Site(tmp_path / "home", "home"), Site(tmp_path / "hospital", "hospital")
    accept(home, hospital)
    home.enroll("/master")
    carry(home)
    async with home.running():
        assert home.master is not None
        uri = home.master.uri

        async def ask(name: str, method: str, *params: object) -> object:
            client = RpcClient(await dial(uri, credentials(hospital, name)))
            try:
                return await client.call(method, name, *params)
            finally:
                await client.close()

        answer = await ask("/master", "rossec.revocationsSince", b"")
        assert isinstance(answer, list)
        revocations, timestamp = answer[2]
        assert revocations == home.authority.store.newest_list()
        assert timestamp, "without it the other side would stay stale as well"
        with pytest.raises(RossecError):
            await ask("/robot", "rossec.revocationsSince", b"")
