"""Cached certificates of peers, so that a handshake may name one by its hash (x5t, RFC 9360).

A lookup key, never trust: only certificates verified in a finished handshake are cached, and what
is found is verified again. A hash that two certificates share finds neither. A peer that does not
know the hash answers with error 3, and the caller retries, by value.
"""

import hashlib
from collections import OrderedDict
from typing import Final, TypeAlias

from ca.encoding import Value
from rossec.channel.edhoc.credentials import X5T, x5chain
from rossec.errors import PeerCredentialUnknown

_SHA256_64: Final = -15  # RFC 9054
_CAPACITY: Final = 256

Chain: TypeAlias = tuple[bytes, ...]


def reference(certificate: bytes) -> Value:
    """The x5t ID_CRED_x of a certificate."""
    return {X5T: [_SHA256_64, _short(certificate)]}


def _short(certificate: bytes) -> bytes:
    return hashlib.sha256(certificate).digest()[:8]


class KnownCertificates:
    """A bounded cache of one node, least recently used first out."""

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._capacity = capacity
        self._chains: OrderedDict[bytes, Chain | None] = OrderedDict()
        self._introduced: OrderedDict[bytes, None] = OrderedDict()
        self._addresses: OrderedDict[tuple[str, int], None] = OrderedDict()

    def __len__(self) -> int:
        return len(self._chains)

    def remember(self, chain: Chain) -> None:
        """Cache a chain that was just verified."""
        key = _short(chain[0])
        there = self._chains.get(key, chain)
        ambiguous = there is None or there[0] != chain[0]
        self._chains[key] = None if ambiguous else chain
        self._chains.move_to_end(key)
        if len(self._chains) > self._capacity:
            self._chains.popitem(last=False)

    def find(self, id_cred: Value) -> Chain:
        """From ID_CRED_x, of either kind, to the chain.

        Raises:
            PeerCredentialUnknown: a reference to an unknown certificate.
            HandshakeFailed: neither a reference nor a chain.
        """
        match id_cred:
            case {34: [-15, bytes() as short], **rest} if not rest:
                chain = self._chains.get(short)
                if chain is None:
                    raise PeerCredentialUnknown(
                        "the peer names a certificate this node does not know"
                    )
                self._chains.move_to_end(short)
                return chain
            case _:
                return x5chain(id_cred)

    def introduce(self, certificate: bytes) -> None:
        """Note that the holder of `certificate` has received this node's own."""
        self._introduced[certificate] = None
        self._introduced.move_to_end(certificate)
        if len(self._introduced) > self._capacity:
            self._introduced.popitem(last=False)

    def is_introduced(self, certificate: bytes) -> bool:
        """Whether the holder of `certificate` is likely to know this node's own."""
        return certificate in self._introduced

    def note_address(self, address: tuple[str, int]) -> None:
        """Note that a known peer was reached at this host and port."""
        self._addresses[address] = None
        self._addresses.move_to_end(address)
        if len(self._addresses) > self._capacity:
            self._addresses.popitem(last=False)

    def knows_address(self, address: tuple[str, int]) -> bool:
        """Whether the certificate of the peer at this host and port is likely to be known."""
        return address in self._addresses

    def forget_introductions(self) -> None:
        """After an error 3: a peer does not know this node's certificate (any more)."""
        self._introduced.clear()
