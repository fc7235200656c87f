"""What the master's calls ask of the authority's statements and the nodes' grants."""

from collections.abc import Generator, Iterable, Sequence
from typing import NamedTuple, Protocol

from rossec.channel.edhoc.credentials import PeerIdentity
from rossec.master.rights.access_rules import Caller, Certified, Peer


class Presented(NamedTuple):
    """How many grants of the caller are held now, and why others are not."""

    held: int
    refused: tuple[str, ...]


class Renewed(NamedTuple):
    """Tokens that hold longer, empty where a grant is not renewed, and why those are not."""

    tokens: tuple[bytes, ...]
    refused: tuple[str, ...]


class Statements(Protocol):
    """What the master holds of the authority's statements; implemented by `rights.statements`."""

    def caller_of(self, peer: Peer, now: int) -> Caller | None:
        """What a name and key seen before may do now; None: the key is revoked."""

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Presented:
        """Keep a caller's grants."""

    def pertaining(
        self, caller: Caller, names: Iterable[str]
    ) -> Generator[None, None, frozenset[bytes]]:
        """What of the list concerns a caller that is registered for `names`.

        Yields wherever others may have their turn.
        """

    def revoked(self) -> frozenset[bytes]:
        """The whole list."""

    def renew(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Renewed:
        """Renew a caller's grants."""

    def renew_identity(self, caller: Caller, request: bytes, now: int) -> bytes:
        """The bundle that succeeds an identity. Raises `HintedError`."""

    def delegated(self, data: bytes) -> bool:
        """Take leave to renew grants; returns whether it is newer. Raises `HintedError`."""

    def current(self, now: int) -> tuple[bytes, bytes]:
        """The revocation list and a timestamp of it; empty while there is none."""

    def update_tree(self, data: bytes, entries: bytes, now: int) -> bool:
        """Take a tree with its entries; as `update`."""

    def proofs(self, entries: Sequence[bytes]) -> list[bytes]:
        """What the tree in force shows of each entry; empty where there is a list."""

    def held_by(self, peer: Peer, held: bytes) -> None:
        """A node says which list it holds, by its digest."""

    def news_for(self, peer: Peer, now: int) -> tuple[bytes, bytes]:
        """As `current`, but without the list for a node that has said that it holds it."""

    def update(self, data: bytes, now: int) -> bool:
        """Take a list; returns whether it is newer. Raises `HintedError`."""


class ChannelPeer(Certified, PeerIdentity, Protocol):
    """A peer as the channel hands it over: `ca.certificates.Identity` is one."""


class TrustView(Statements, Protocol):
    """What the authority has said and the nodes have shown; implemented by `rights.statements`."""

    def caller(self, peer: Certified, now: int) -> Caller:
        """Who calls and what it may do now; remembers the peer. Raises `HintedError`: revoked."""

    @property
    def number(self) -> int:
        """Sequence number of the revocation list in force; 0: none."""

    def keep_only(self, thumbprints: frozenset[bytes], now: int) -> None:
        """Forget what identities presented that are neither connected nor registered."""
