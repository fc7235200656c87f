"""What a node sends of itself in the handshake: a certificate chain by value (x5chain, RFC 9360).

The chain travels in ID_CRED_x, CRED_x is the end-entity certificate exactly as it travelled. By
value means there is nothing to look up and nothing to confuse; a reference (x5t) would be a lookup
key, never trust. Whether a chain is *trusted* is decided by the caller's `verify`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias, TypeVar

from ca.encoding import Value, encode
from ca.keys.signer import Signer
from rossec.channel.edhoc.keyschedule import bstr
from rossec.channel.edhoc.suites import PublicKey
from rossec.errors import HandshakeFailed, PeerCredentialUnknown

X5CHAIN: Final = 33  # RFC 9360 section 2
X5T: Final = 34
X5CHAIN_HEAD: Final = b"\xa1\x18\x21"  # a map of one entry, its key 33
MAX_CHAIN: Final = 4
_MAX_CERTIFICATE: Final = 7 * 1024  # PLAINTEXT_2 cannot carry more than 8160 bytes


class PeerIdentity(Protocol):
    """What the channel must know about a verified peer."""

    @property
    def public_key(self) -> PublicKey:
        """The key in its certificate."""
        ...

    @property
    def not_after(self) -> int:
        """The second from which the certificate no longer holds."""
        ...


PeerT = TypeVar("PeerT", bound=PeerIdentity)

Verify: TypeAlias = Callable[[tuple[bytes, ...], int], PeerT]
"""From the chain (DER, end entity first) and `now` to the identity; raises a `HintedError`.

A caller that expects one particular peer compares the certified name here.
"""

Renews: TypeAlias = Callable[[PeerT, PeerT], bool]
"""Whether the first identity, which was verified, is the second one renewed."""

FindChain: TypeAlias = Callable[[Value], tuple[bytes, ...]]
"""From ID_CRED_x to the chain it names."""


class OwnCredential(Protocol):
    """What the handshake needs of this side's credential."""

    @property
    def id_cred(self) -> Value:
        """ID_CRED_x, a COSE header map."""
        ...

    @property
    def certificate(self) -> bytes:
        """CRED_x without its CBOR frame: the DER of the end-entity certificate."""
        ...

    @property
    def public_key(self) -> PublicKey:
        """The certified key."""
        ...

    @property
    def shared(self) -> bool:
        """Whether several nodes hold this key: a peer that sends it is not a reflection."""
        ...

    def sign(self, message: bytes) -> bytes:
        """Sign with the certified key: 64 bytes."""
        ...


@dataclass(frozen=True)
class Credentials:
    """A node's key and its certificate chain, end entity first, without the trust anchor.

    `shared`: the identity has a wildcard tail, so several nodes have it.
    """

    signer: Signer
    chain: tuple[bytes, ...]
    shared: bool = False

    @property
    def id_cred(self) -> Value:
        """`{33: certificate}`, or `{33: [certificate, ...]}` for a longer chain."""
        return {X5CHAIN: self.chain[0] if len(self.chain) == 1 else list(self.chain)}

    @property
    def certificate(self) -> bytes:
        """The end-entity certificate, DER."""
        return self.chain[0]

    @property
    def public_key(self) -> PublicKey:
        """The certified key."""
        return self.signer.public_key

    def sign(self, message: bytes) -> bytes:
        """ES256 over `message`."""
        return self.signer.sign(message)


class LiveCredentials:
    """Credentials that may be replaced: the next handshake sends the new ones.

    Attributes:
        on_change: called with the new chain.
    """

    def __init__(self, current: Credentials) -> None:
        self._current = current
        self.on_change: list[Callable[[tuple[bytes, ...]], None]] = []

    @property
    def current(self) -> Credentials:
        """Those of the next handshake."""
        return self._current

    @current.setter
    def current(self, renewed: Credentials) -> None:
        self._current = renewed
        for call in self.on_change:
            call(renewed.chain)

    @property
    def id_cred(self) -> Value:
        """As of `Credentials`."""
        return self.current.id_cred

    @property
    def certificate(self) -> bytes:
        """As of `Credentials`."""
        return self.current.certificate

    @property
    def public_key(self) -> PublicKey:
        """As of `Credentials`."""
        return self.current.public_key

    @property
    def shared(self) -> bool:
        """As of `Credentials`."""
        return self.current.shared

    def sign(self, message: bytes) -> bytes:
        """As of `Credentials`; the key is the same before and after."""
        return self.current.sign(message)


def encode_id_cred(id_cred: Value) -> bytes:
    """What `encode` gives, at a third of the cost for a chain of one."""
    certificate = id_cred.get(X5CHAIN) if isinstance(id_cred, dict) and len(id_cred) == 1 else None
    return X5CHAIN_HEAD + bstr(certificate) if isinstance(certificate, bytes) else encode(id_cred)


def x5chain(id_cred: Value) -> tuple[bytes, ...]:
    """Return the chain an x5chain ID_CRED_x carries.

    Raises:
        PeerCredentialUnknown: a reference, where no certificates are cached.
        HandshakeFailed: another kind of credential, or not a chain of 1 to 4 certificates.
    """
    if isinstance(id_cred, dict) and X5T in id_cred:
        raise PeerCredentialUnknown(
            "the peer names a certificate by its hash, and this node caches none"
        )
    named = id_cred.get(X5CHAIN) if isinstance(id_cred, dict) and len(id_cred) == 1 else None
    match named:
        case bytes():
            return _checked([named])
        case [_, _, *_]:
            return _checked(named)
        case _:
            raise HandshakeFailed("the peer's credential is not a certificate chain")


def _checked(chain: list[Value]) -> tuple[bytes, ...]:
    certificates = tuple(item for item in chain if isinstance(item, bytes))
    if len(certificates) != len(chain) or len(chain) > MAX_CHAIN:
        raise HandshakeFailed(f"not a chain of 1 to {MAX_CHAIN} certificates")
    if not all(0 < len(certificate) <= _MAX_CERTIFICATE for certificate in certificates):
        raise HandshakeFailed("a certificate of the chain is empty or too long")
    return certificates
