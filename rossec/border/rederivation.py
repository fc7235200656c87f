"""OSCORE contexts of a thing with a secret of its own (RFC 8613 Appendix B.2). Pure.

Neither side writes sequence numbers to a disk. After a restart of either, both contribute a random
value to a new context: ID1 by the thing, R2 by the border router, R3 by the thing. R2 shows itself
to be of this process and recent, so an attempt costs no memory. Only one that is newer than any
that the thing has answered makes a new context, also when the former one was dropped: who repeats
recorded requests changes nothing, and no context begins a second time with its nonces.
"""

import hmac
from dataclasses import dataclass, field
from typing import Final

from ca.encoding import decode, encode
from ca.errors import EncodingError
from rossec.border.contexts import OscoreContext
from rossec.errors import DatagramRefused

NONCE_SIZE: Final = 8  # of ID1 and R3
R2_SIZE: Final = 16  # milliseconds (6), random (2), tag (8)
MAX_ID1: Final = 32
LIFETIME: Final = 30_000  # milliseconds in which the thing answers R2
BORDER_ID: Final = b""  # the border router's sender ID in contexts of a secret
_SALT: Final = b""
_TIME: Final = 6


def wrapped(value: bytes) -> bytes:
    """A value as it is in a kid context: a CBOR byte string."""
    return encode(value)


def unwrapped(kid_context: bytes) -> bytes:
    """The value in a kid context.

    Raises:
        DatagramRefused: not a CBOR byte string of a length that is used.
    """
    try:
        value = decode(kid_context, limit=MAX_ID1 + 2)
    except EncodingError as error:
        raise DatagramRefused(f"a kid context that is no byte string: {error}") from None
    if not isinstance(value, bytes) or not NONCE_SIZE <= len(value) <= MAX_ID1:
        raise DatagramRefused("a kid context of another length")
    return value


def is_in(context: OscoreContext, kid_context: bytes | None) -> bool:
    """Whether a request that names this context (None: none) may be in it."""
    if kid_context is None:
        return True
    return context.id_context is not None and wrapped(context.id_context) == kid_context


@dataclass(frozen=True)
class Challenges:
    """Makes and recognizes R2.

    Args:
        key: 16 random octets of this process.
    """

    key: bytes
    _answered: dict[bytes, int] = field(default_factory=dict)  # by kids that proved their secret

    def make(self, kid: bytes, now: float, random: bytes) -> bytes:
        """R2 for the thing `kid`; `random` has 2 octets, `now` are seconds of one clock."""
        head = int(now * 1000).to_bytes(_TIME) + random
        return head + self._tag(kid, head)

    def issued(self, kid: bytes, value: bytes, now: float) -> int:
        """When the R2 that `value` begins with was made, milliseconds; 0: not here, or long ago."""
        head, tag = value[: R2_SIZE // 2], value[R2_SIZE // 2 : R2_SIZE]
        if not hmac.compare_digest(tag, self._tag(kid, head)):
            return 0
        made = int.from_bytes(head[:_TIME])
        return made if int(now * 1000) - made <= LIFETIME else 0

    def take(self, kid: bytes, value: bytes, now: float) -> bool:
        """Whether `value`, which the thing `kid` has protected, is its first answer to an R2."""
        if len(value) != R2_SIZE + NONCE_SIZE:
            return False
        issued = self.issued(kid, value, now)
        if issued <= self._answered.get(kid, 0):
            return False
        self._answered[kid] = issued
        return True

    def _tag(self, kid: bytes, head: bytes) -> bytes:
        return hmac.digest(self.key, bytes((len(kid),)) + kid + head, "sha256")[: R2_SIZE // 2]


def border_context(secret: bytes, kid: bytes, id_context: bytes) -> OscoreContext:
    """The border router's context with the thing `kid`."""
    return OscoreContext(secret, _SALT, BORDER_ID, kid, id_context)


def thing_context(secret: bytes, kid: bytes, id_context: bytes) -> OscoreContext:
    """The same context as the thing has it."""
    return OscoreContext(secret, _SALT, kid, BORDER_ID, id_context)
