"""The certificates by which other masters were verified: a foreign one's timestamp needs its own.

The handshake gives the identity alone; nodes verify a foreign master's word themselves, so its
chain is passed on to them.
"""

from collections import OrderedDict
from typing import Final

from ca.certificates import Identity
from rossec.channel.edhoc.credentials import Verify

MAX_CHAINS: Final = 256


class Chains:
    """The newest chain of each key, bounded."""

    def __init__(self) -> None:
        self._chains: OrderedDict[bytes, tuple[bytes, ...]] = OrderedDict()

    def recording(self, verify: Verify[Identity]) -> Verify[Identity]:
        """As `verify`, and what it accepts is kept."""

        def verified(chain: tuple[bytes, ...], now: int) -> Identity:
            identity = verify(chain, now)
            self._chains.pop(identity.thumbprint, None)
            self._chains[identity.thumbprint] = chain
            if len(self._chains) > MAX_CHAINS:
                self._chains.popitem(last=False)
            return identity

        return verified

    def of(self, identity: Identity) -> tuple[bytes, ...]:
        """The chain of a verified identity; empty: none is kept."""
        return self._chains.get(identity.thumbprint, ())
