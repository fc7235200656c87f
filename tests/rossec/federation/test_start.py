from pathlib import Path

from rossec.federation.mesh import mesh_of
from rossec.federation.settings import FederationConfig, SiteFile, SiteSettings
from tests.support.masters import Master, masters
from tests.support.site import Site
from tests.support.witness import until


async def test_the_configuration_prevails_over_the_file(tmp_path: Path) -> None:
    """Both name the kitchen; where the file says it is, nobody answers."""
    async with masters(Site(tmp_path / "site"), "/master", "/master/kitchen") as (hall, kitchen):
        elsewhere = SiteSettings("kitchen", "http://127.0.0.1:9/", "/master/kitchen")
        attic = SiteSettings("attic", "http://127.0.0.1:9/", "/master/attic")
        file = SiteFile(hall.home.path)
        file.change(lambda sites: sites.update({"kitchen": elsewhere, "attic": attic}))
        hall.follow(kitchen.as_site("kitchen"))
        await until(lambda: hall.state_of("kitchen")["state"] == "following")
        assert source(hall, "kitchen") == "configuration"
        assert source(hall, "attic") == "file"


def source(master: Master, label: str) -> str:
    return str(master.state_of(label)["source"])


async def test_announced_masters_are_followed_where_this_is_configured(tmp_path: Path) -> None:
    async with masters(Site(tmp_path / "site"), "/master") as (hall,):
        for follows in (False, True):
            config = FederationConfig(follow_announced=follows)
            mesh = mesh_of(hall.server, hall.home, config)
            assert ("announced" in mesh._sources) is follows
            assert {"configuration", "file"} <= mesh._sources.keys()
