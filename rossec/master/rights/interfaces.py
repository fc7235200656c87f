"""The interfaces by which the master's calls use the authority's statements and the grants."""

from collections.abc import Generator, Iterable, Sequence
from typing import NamedTuple, Protocol

from rossec.channel.edhoc.credentials import PeerIdentity
from rossec.master.rights.access_rules import Caller, Certified, Peer


class Presented(NamedTuple):
    """How many grants of the caller are held now, and why the others were refused."""

    held: int
    refused: tuple[str, ...]


class Renewed(NamedTuple):
    """Renewed tokens, empty where one was refused, and the reasons."""

    tokens: tuple[bytes, ...]
    refused: tuple[str, ...]


class Statements(Protocol):
    """The authority's statements that the master holds; implemented by `rights.statements`."""

    def caller_of(self, peer: Peer, now: int) -> Caller | None:
        """A name and key seen before, with its rights now; None: the key is revoked."""

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Presented:
        """Verify and store a caller's grants."""

    def has_presented(self, holder: bytes, grant_id: bytes) -> bool:
        """Whether the key `holder` has presented this grant."""

    def pertaining(
        self, caller: Caller, names: Iterable[str]
    ) -> Generator[None, None, frozenset[bytes]]:
        """The revoked entries that pertain to a caller that is registered for `names`.

        Yields where other calls may be answered.
        """

    def revoked(self) -> frozenset[bytes]:
        """All revoked entries."""

    def renew(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Renewed:
        """Renew a caller's grants."""

    def renew_identity(self, caller: Caller, request: bytes, now: int) -> bytes:
        """The bundle of a renewed identity. Raises `HintedError`."""

    def update_delegation(self, data: bytes) -> bool:
        """Accept a delegation of renewal; returns whether it is newer. Raises `HintedError`."""

    def current(self, now: int) -> tuple[bytes, bytes]:
        """The revocation list and a timestamp of it; both empty while there is none."""

    def update_tree(self, data: bytes, entries: bytes, now: int) -> bool:
        """Accept a tree with its entries; as `update`."""

    def proofs(self, entries: Sequence[bytes]) -> list[bytes]:
        """The proof of each entry in the tree in force; empty where a list is in force."""

    def record_held_list(self, peer: Peer, digest: bytes) -> None:
        """Record which list a node says it holds, by its digest."""

    def revocations_for(self, peer: Peer, now: int) -> tuple[bytes, bytes]:
        """As `current`, but without the list if the node has said that it holds it."""

    def update(self, data: bytes, now: int) -> bool:
        """Accept a list; returns whether it is newer. Raises `HintedError`."""


class ChannelPeer(Certified, PeerIdentity, Protocol):
    """A peer as the channel authenticates it: `ca.certificates.Identity` is one."""


class TrustView(Statements, Protocol):
    """Revocations and presented grants; implemented by `rights.statements`."""

    def caller(self, peer: Certified, now: int) -> Caller:
        """The caller with its rights now; stores its keys. Raises `HintedError`: revoked."""

    @property
    def number(self) -> int:
        """Sequence number of the revocation list in force; 0: none."""

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        """Discard what was presented by all other keys."""
