"""The parts of `Access` used here: a program with threads passes an object with a lock."""

from typing import Protocol

from ca.certificates import Identity
from grants.decision import Decision
from grants.model import Right
from rossec.participant.access import HeldGrant


class HandshakeAccess(Protocol):
    """Proves this node's rights and authorizes peers."""

    def present(self, right: Right, name: str, now: int) -> bytes:
        """See `Access.present`."""

    def is_master(self, peer: Identity) -> bool:
        """See `Access.is_master`."""

    def check_peer(self, peer: Identity, now: int) -> None:
        """See `Access.check_peer`."""

    def authorize(
        self, peer: Identity, presented: bytes | None, right: Right, name: str, now: int
    ) -> Decision:
        """See `Access.authorize`."""


class HeldGrants(Protocol):
    """The grants this node holds."""

    @property
    def epoch(self) -> int:
        """See `Access.epoch`."""

    def hold(self, data: bytes) -> None:
        """See `Access.hold`."""

    def hold_renewed(self, token: bytes, now: int) -> None:
        """See `Access.hold_renewed`."""

    def held_grants(self) -> list[HeldGrant]:
        """See `Access.held_grants`."""
