"""What a peer may use before and after it has shown a grant, over real connections."""

import contextlib

from grants.model import Right
from rossec.errors import RossecError
from rossec.master.operation.config import MasterLimits
from rossec.net.rpc.calls import RpcClient
from tests.support.attacker import EVE, credentials, dial
from tests.support.caller import caller
from tests.support.site import Site


async def test_a_grant_that_is_valid_shows_a_right(site: Site) -> None:
    assert site.master is not None
    admission = site.master._admission
    async with caller(site, "/bob") as bob:
        peer = site.enroll("/bob").identity(site.now())
        assert not admission.has_rights(peer)
        assert admission.body_bound(peer) == MasterLimits().body_without_right
        grant = site.grant("/bob", Right.PUBLISH, "/t")
        await bob("rossec.presentGrants", site.enroll("/bob").grants())
        assert admission.has_rights(peer)
        assert admission.body_bound(peer) == MasterLimits().body
        await bob("rossec.updateRevocations", site.revoke(grant))
        assert not admission.has_rights(peer)
        with contextlib.suppress(RossecError):  # the connection ends with it
            await bob("rossec.updateRevocations", site.revoke(peer.thumbprint))
        assert not admission.has_rights(peer)


async def test_connections_count_together_until_a_grant_is_shown(site: Site) -> None:
    assert site.master is not None
    site.master._admission._limits = MasterLimits(connections_without_right=2, connections_per_identity=3)
    own = credentials(site)
    async with contextlib.AsyncExitStack() as stack:

        async def another() -> bool:
            """Whether one more connection of Eve is served."""
            client = RpcClient(await dial(site.master.uri, own))  # type: ignore[union-attr]
            stack.push_async_callback(client.close)
            with contextlib.suppress(Exception):
                await client.call("getPid", EVE)
                return True
            return False

        assert await another()
        assert await another()
        assert not await another()
        site.grant(EVE, Right.PUBLISH, "/t")
        peer = site.enroll(EVE).identity(site.now())
        for grant in site.enroll(EVE).grants():
            site.master.state.trust.present(
                site.master.state.trust.caller(peer, site.now()), [grant], site.now()
            )
        assert await another()
        assert not await another(), "the other limit"
