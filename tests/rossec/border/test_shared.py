"""What all identities of a border router share."""

from rossec.border.constrained_node import AT_A_TIME
from tests.rossec.border.test_thing_node import shared_by
from tests.support.site import Site


async def test_it_is_what_the_routers_node_has(site: Site) -> None:
    async with site.node("/border") as node:
        shared = shared_by(node)
        assert shared.trust_status is node.access.trust_status
        assert shared.held_list() == node.revocations.data != b""
        assert shared.turns._value == AT_A_TIME
