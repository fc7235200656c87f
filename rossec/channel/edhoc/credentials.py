"""Who a side says it is in the handshake: a certificate chain by value (x5chain) or by hash (x5t), RFC 9360.

The chain travels in ID_CRED_x; CRED_x is the end-entity certificate exactly as it travelled. Whether a chain
is *trusted* is decided by the caller's `verify`, never here: a hash is a lookup key, only certificates
verified in a finished handshake are cached, and what is found is verified again. A peer that does not know
the hash answers with error 3, and the caller retries, by value.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias, TypeVar
from weakref import WeakValueDictionary

from ca.bounded import Newest
from ca.encoding import Value, encode
from ca.keys.signing import Signer
from rossec.channel.edhoc.suites import PublicKey, bstr
from rossec.errors import HandshakeFailed, PeerCredentialUnknown

Chain: TypeAlias = tuple[bytes, ...]  # DER, end entity first

X5CHAIN: Final = 33  # RFC 9360 section 2
X5T: Final = 34
X5CHAIN_HEAD: Final = b"\xa1\x18\x21"  # a map of one entry, its key 33
MAX_CHAIN: Final = 4
_MAX_CERTIFICATE: Final = 7 * 1024  # PLAINTEXT_2 cannot carry more than 8160 bytes
_SHA256_64: Final = -15  # RFC 9054
_CAPACITY: Final = 256


class PeerIdentity(Protocol):
    @property
    def public_key(self) -> PublicKey: ...
    @property
    def not_after(self) -> int: ...


PeerT = TypeVar("PeerT", bound=PeerIdentity)

Verify: TypeAlias = Callable[[Chain, int], PeerT]
"""From the chain and `now` to the identity; raises a `HintedError`.

A caller that expects one particular peer compares the certified name here.
"""

Renews: TypeAlias = Callable[[PeerT, PeerT], bool]
"""Whether the first identity, which was verified, is the second one renewed."""

FindChain: TypeAlias = Callable[[Value], Chain]
"""From ID_CRED_x to the chain it names."""


@dataclass(frozen=True)
class Credentials:
    """A node's key and its certificate chain, without the trust anchor; `shared`: several nodes have it."""

    signer: Signer
    chain: Chain
    shared: bool = False

    @property
    def id_cred(self) -> Value:
        return by_value(self.chain)

    @property
    def certificate(self) -> bytes:
        return self.chain[0]

    @property
    def current(self) -> "Credentials":
        return self


class LiveCredentials:
    """Credentials that may be replaced: the next handshake sends the new ones; `on_change` is told."""

    def __init__(self, current: Credentials) -> None:
        self._current = current
        self.on_change: list[Callable[[Chain], None]] = []

    @property
    def current(self) -> Credentials:
        return self._current

    @current.setter
    def current(self, renewed: Credentials) -> None:
        self._current = renewed
        for call in self.on_change:
            call(renewed.chain)


OwnCredential: TypeAlias = Credentials | LiveCredentials


def by_value(chain: Sequence[bytes]) -> Value:
    return {X5CHAIN: chain[0] if len(chain) == 1 else list(chain)}


def encode_id_cred(id_cred: Value) -> bytes:
    """What `encode` gives, at a third of the cost for a chain of one."""
    certificate = id_cred.get(X5CHAIN) if isinstance(id_cred, dict) and len(id_cred) == 1 else None
    return X5CHAIN_HEAD + bstr(certificate) if isinstance(certificate, bytes) else encode(id_cred)


def x5chain(id_cred: Value) -> Chain:
    if isinstance(id_cred, dict) and X5T in id_cred:
        raise PeerCredentialUnknown("the peer names a certificate by its hash, and this node caches none")
    named = id_cred.get(X5CHAIN) if isinstance(id_cred, dict) and len(id_cred) == 1 else None
    chain: list[Value]
    match named:
        case bytes():
            chain = [named]
        case [_, _, *_]:
            chain = named
        case _:
            raise HandshakeFailed("the peer's credential is not a certificate chain")
    certificates = tuple(item for item in chain if isinstance(item, bytes))
    if len(certificates) != len(chain) or len(chain) > MAX_CHAIN:
        raise HandshakeFailed(f"not a chain of 1 to {MAX_CHAIN} certificates")
    if not all(0 < len(certificate) <= _MAX_CERTIFICATE for certificate in certificates):
        raise HandshakeFailed("a certificate of the chain is empty or too long")
    return certificates


def reference(certificate: bytes) -> Value:
    return {X5T: [_SHA256_64, _short(certificate)]}


def _short(certificate: bytes) -> bytes:
    return hashlib.sha256(certificate).digest()[:8]


class KnownCertificates:
    """A bounded cache of one node, least recently used first out; a hash that two share finds neither."""

    def __init__(self, capacity: int = _CAPACITY) -> None:
        self._chains: Newest[bytes, Chain | None] = Newest(capacity)
        self.introduced: Newest[bytes, None] = Newest(capacity)  # certificates whose holders have the own one
        self.addresses: Newest[tuple[str, int], None] = Newest(capacity)  # where a known peer was reached

    def __len__(self) -> int:
        return len(self._chains)

    def remember(self, chain: Chain) -> None:
        key = _short(chain[0])
        there = self._chains.get(key, chain)
        ambiguous = there is None or there[0] != chain[0]
        self._chains[key] = None if ambiguous else chain

    def find(self, id_cred: Value) -> Chain:
        match id_cred:
            case {34: [-15, bytes() as short], **rest} if not rest:
                chain = self._chains.use(short)
                if chain is None:
                    raise PeerCredentialUnknown("the peer names a certificate this node does not know")
                return chain
            case _:
                return x5chain(id_cred)


@dataclass(eq=False, slots=True, weakref_slot=True)
class Dial:
    g_y: bytes | None = None


class SelfConnections:
    """The pending dials of one node that are meant for itself; threads may share it.

    ROS programs subscribe to their own topics and call their own services. Anywhere else the own certificate
    is a reflection (the selfie attack, ePrint 2019/347): a redirect would connect a node to itself instead of
    another one. So a dial meant for the node itself is noted by its G_X, the responder that receives that G_X
    adds its G_Y, and both sides check for exactly this pair. Forwarding, repeating or redirecting messages
    does not change the pair, and another process with the same key is not found here.
    """

    def __init__(self) -> None:
        self._pending: WeakValueDictionary[bytes, Dial] = WeakValueDictionary()

    def __len__(self) -> int:
        return len(self._pending)

    def begin(self, g_x: bytes) -> Dial:
        dial = self._pending[g_x] = Dial()
        return dial

    def answer(self, g_x: bytes, g_y: bytes) -> None:
        """Note the answer of this node, if the dial is one of its own: the first one counts."""
        dial = self._pending.get(g_x)
        if dial is not None and dial.g_y is None:
            dial.g_y = g_y

    def is_own(self, g_x: bytes, g_y: bytes) -> bool:
        dial = self._pending.get(g_x)
        return dial is not None and dial.g_y == g_y
