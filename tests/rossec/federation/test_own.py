from pathlib import Path

from rossec.federation.exchange import Chains, OwnMaster
from tests.support.masters import masters
from tests.support.site import Site


async def test_the_own_master_calls_itself_by_its_certified_name(tmp_path: Path) -> None:
    async with masters(Site(tmp_path / "site"), "/master/kitchen") as (kitchen,):
        server = kitchen.server
        own = OwnMaster(server.state, server.effects, server.context, server.mirror, server.drop_mirror)
        assert own.name == "/master/kitchen"
        assert own.grants() == ()
        assert isinstance(own.chains, Chains)
