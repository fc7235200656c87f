"""What a node is told of the revocations: its own, and those of the names it is registered for."""

from grants.document import grant_id
from grants.model import Right
from rossec.master.rights.caller import Caller
from tests.rossec.master.rights.trust_world import World, update_delegation


def test_entries_that_pertain_to_a_node(world: World) -> None:
    other, third = world.site.enroll("/other"), world.site.enroll("/third")
    own, is_local, far, unseen = (
        world.site.grant(who, {name: Right.SUBSCRIBE})
        for who, name in ((world.node, "/own"), (other, "/t"), (third, "/far"), (other, "/unseen"))
    )
    update_delegation(world)
    id_ = world.trust._delegate.id
    assert id_ is not None
    for who, token in ((world.node, own), (other, is_local), (third, far)):
        world.trust.present(world.trust.caller(who.identity, world.now), [token], world.now)
    world.trust.update(world.site.revoke(own, is_local, far, unseen, other, id_), world.now)
    world.trust.keep_only(frozenset(), world.now)
    caller = world.trust.caller(world.node.identity, world.now)
    mine = {grant_id(own), id_}
    assert pertaining(world, caller) == mine
    assert pertaining(world, caller, "/t") == mine | {grant_id(is_local), other.thumbprint}
    assert len(world.trust.revoked()) == 6
    world.trust.update(world.site.revoke(far), world.now)
    assert pertaining(world, caller, "/t", "/far") == {grant_id(far)}


def pertaining(world: World, caller: Caller, *names: str) -> frozenset[bytes]:
    work = world.trust.pertaining(caller, names)
    while True:
        try:
            next(work)
        except StopIteration as end:
            found: frozenset[bytes] = end.value
            return found
