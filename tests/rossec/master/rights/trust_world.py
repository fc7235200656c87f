"""A `TrustState` with statements signed by an authority."""

from grants.model import Right
from rossec.master.rights.statements import TrustState
from tests.support.authority import Site


class World:
    def __init__(self) -> None:
        self.site = Site()
        self.now = self.site.now
        self.master = self.site.enroll("/master")
        self.node = self.site.enroll("/node")
        self.persisted: list[bytes] = []
        self.trust = TrustState(
            self.site.anchor, self.master.credentials.signer, self.site.revocations(), self.persisted.append
        )

    def may(self, right: Right, name: str, later: int = 0) -> bool:
        return self.trust.caller(self.node.identity, self.now + later).may(right, name)

    def present(self, *tokens: bytes) -> tuple[int, tuple[str, ...]]:
        return self.trust.present(self.trust.caller(self.node.identity, self.now), tokens, self.now)


def update_delegation(world: World) -> World:
    assert world.trust.update_delegation(world.site.delegation(world.master))
    return world
