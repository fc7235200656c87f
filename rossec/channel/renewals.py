"""What is renewed while a connection is open: the certificates of both sides. Grants pass unread.

A renewed certificate is verified as one in the handshake is, and must be of the same key and name:
who holds the key was proven then. One that is refused changes nothing. Each costs signatures to
verify, so a peer may present few, and its connection ends when it presents more.
"""

from collections.abc import Sequence
from typing import Final, Generic

from ca.encoding import Value, decode
from ca.errors import EncodingError
from rossec.channel.edhoc.credentials import X5CHAIN, PeerT, Renews, Verify, encode_id_cred, x5chain
from rossec.channel.edhoc.messages import MAX_MESSAGE
from rossec.errors import HandshakeFailed, IdentityRefused, LimitExceeded

MOST_AT_ONCE: Final = 12
SECONDS_EACH: Final = 2
"""A peer may present so many at once, and then one in so many seconds."""


class Renewals(Generic[PeerT]):
    """Of one connection between sides that both take renewals.

    Args:
        verify: as in the handshake.
        renews: whether an identity is another one renewed.
        sent: the certificate that this side sent in the handshake.
        now: when the connection opened.
    """

    __slots__ = ("_charged_at", "_left", "_renews", "_sent", "_verify")

    def __init__(self, verify: Verify[PeerT], renews: Renews[PeerT], sent: bytes, now: int) -> None:
        self._verify = verify
        self._renews = renews
        self._sent = sent
        self._left = MOST_AT_ONCE * SECONDS_EACH
        self._charged_at = now

    def charge(self, now: int) -> None:
        """Count what the peer presents.

        Raises:
            LimitExceeded: it presents too often.
        """
        passed = max(0, now - self._charged_at)
        self._charged_at = now
        self._left = min(MOST_AT_ONCE * SECONDS_EACH, self._left + passed) - SECONDS_EACH
        if self._left < 0:
            raise LimitExceeded("the peer presents certificates or grants too often")

    def identity(self, data: bytes, held: PeerT, now: int) -> PeerT:
        """The peer's identity by the certificates in `data`, an ID_CRED as in the handshake.

        Raises:
            HintedError: they are refused; `held` stays.
        """
        try:
            value: Value = decode(data, limit=MAX_MESSAGE)
        except EncodingError as error:
            raise HandshakeFailed(f"an unreadable certificate: {error}") from None
        renewed = self._verify(x5chain(value), now)
        if not self._renews(renewed, held):
            raise IdentityRefused(
                "the certificate is another node's, not this one's renewed",
                "a certificate with another key or name needs a new connection",
            )
        return renewed

    def own(self, chain: Sequence[bytes]) -> bytes | None:
        """What to send when `chain` is this side's; None: the peer has it already."""
        if chain[0] == self._sent:
            return None
        self._sent = chain[0]
        return encode_id_cred({X5CHAIN: chain[0] if len(chain) == 1 else list(chain)})
