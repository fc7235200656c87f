"""An access that allows everything, and records by which names it was asked."""

import time

from ca.certificates import Identity
from grants.decision import Decision
from grants.model import Right
from rossec.participant.access import FIELD, Access
from rossec.ros.names import MASTER

PROOF = {FIELD: b"proof"}


class OpenAccess(Access):
    """Rights on every name, also on aliases; it holds and verifies nothing."""

    def __init__(self) -> None:
        self.presented: list[tuple[str, str]] = []
        self.authorized: list[tuple[str, str, str]] = []

    def present(self, right: Right, name: str, now: int) -> bytes:
        self.presented.append((right.label, name))
        return PROOF[FIELD]

    def is_master(self, peer: Identity) -> bool:
        return peer.name == MASTER

    def check_peer(self, peer: Identity, now: int) -> None:
        """Every peer is valid."""

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision:
        self.authorized.append((peer.name, right.label, name))
        return Decision(right, name, (), int(time.time()) + 3600, ())
