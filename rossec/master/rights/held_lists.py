"""Which revocation list each node holds, as it said itself or acknowledged. Pure.

Used not to send a list again, and to tell the authority how far a list has come. A node that lies
about it is sent no list and becomes stale by itself, so nothing rests on these words.
"""

from collections.abc import Iterable
from typing import Final, NamedTuple

from rossec.master.rights.caller import Peer

MAX_HELD_LISTS: Final = 16 * 1024  # nodes whose list is recorded
SILENT_AFTER: Final = 35  # seconds; a node says every 10 s what it holds


class ListStanding(NamedTuple):
    """How many nodes have a session, how many of them hold a list, and the names of the others."""

    nodes: int
    holding: int
    lacking: tuple[str, ...]


class HeldLists:
    """The list of each node, by its name and key, as a digest."""

    def __init__(self) -> None:
        self._held: dict[tuple[str, bytes], tuple[bytes, int]] = {}

    def record(self, peer: Peer, digest: bytes, now: int) -> None:
        """Record what a node holds at `now`."""
        key = peer.name, peer.thumbprint
        if len(self._held) >= MAX_HELD_LISTS and key not in self._held:
            self._held.clear()  # a wildcard identity has as many names as it wants
        self._held[key] = digest, now

    def holds(self, peer: Peer, digest: bytes) -> bool:
        """Whether a node said that it holds this list."""
        return self._held.get((peer.name, peer.thumbprint), (None, 0))[0] == digest

    def keep_only(self, thumbprints: frozenset[bytes]) -> None:
        """Discard what all other keys hold."""
        self._held = {key: held for key, held in self._held.items() if key[1] in thumbprints}

    def standing(self, connected: Iterable[Peer], digest: bytes, now: int) -> ListStanding:
        """How far a list has come among the `connected`, certified identities.

        Nodes of a wildcard identity count one by one, as long as they speak. An identity that is
        connected and silent counts as one node that does not hold the list.
        """
        speaking: dict[bytes, list[tuple[str, bool]]] = {}
        for (name, key), (held, at) in self._held.items():
            if now - at <= SILENT_AFTER:
                speaking.setdefault(key, []).append((name, held == digest))
        identities = {peer.thumbprint: peer.name for peer in connected}
        found = [
            node for key, name in identities.items() for node in speaking.get(key, [(name, False)])
        ]
        lacking = sorted(name for name, holds in found if not holds)
        return ListStanding(len(found), len(found) - len(lacking), tuple(lacking))
