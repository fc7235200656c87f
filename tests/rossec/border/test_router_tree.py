"""A border router where so much was revoked that the list is a tree: it asks for proofs."""

import secrets

from ca.encoding import encode
from ca.revocation.lists import is_tree
from tests.support.border import LAMP, BorderSite
from tests.support.rawthing import RawThing
from tests.support.site import Site
from tests.support.witness import until

MANY = 4200
LINKS = b'</t>;rt="ros.pub";if="std_msgs/Float32";title="~temperature";ct=60'


async def test_things_are_served_and_end_by_a_tree(site: Site) -> None:
    many = frozenset(secrets.token_bytes(16) for _ in range(MANY))
    site.authority.revoke_all(many, "test", site.now())
    newest = site.authority.store.newest_list()
    assert newest is not None
    assert is_tree(newest)
    await site.restart_master()
    async with BorderSite(site).running() as border:
        thing = RawThing(border.address, border.key.credential, LINKS, state=encode({"data": 1.5}))
        border.state(LAMP, thing.credential)
        border.allow()
        for number in range(100):
            other = RawThing(border.address, border.key.credential, kid=number.to_bytes(2))
            border.state(f"/things/t{number}", other.credential)
        await thing.start()
        router = border.router
        router.roster.reload()  # else within a second
        router._proved_for = b""
        revocations = router.node.revocations
        await until(lambda: all(map(revocations.is_proved, router.roster.entries())), within=20)
        assert await thing.register()
        await until(lambda: LAMP in router.bridges and router.bridges[LAMP].received, within=20)
        site.authority.revoke(border.roster_statement(LAMP).id, "test", site.now())
        await site.restart_master()
        await until(lambda: LAMP not in router.bridges, within=20)
        thing.close()
