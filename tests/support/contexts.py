"""Contexts of the fake nodes in `wire`, whose certificates last on the host's clock."""

from typing import Any

from rossec.channel.edhoc.credentials import Credentials, Verify
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.net.context import SecureContext
from tests.support.wire import DEFAULTS, FakeIdentity, trust

LIVE = 1 << 40  # a not_after later than the host's clock


def live(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
    found = trust(chain, now)
    return FakeIdentity(found.name, found.public_key, found.certificate, LIVE)


def context(
    credentials: Credentials,
    verify: Verify[FakeIdentity] = live,
    limits: ChannelLimits = DEFAULTS,
    **options: Any,
) -> SecureContext[FakeIdentity]:
    """With the same limits for every connection."""
    every = dict.fromkeys(WireProtocol, limits)
    return SecureContext(credentials, verify, dial_limits=every, accept_limits=every, **options)
