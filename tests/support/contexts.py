"""Contexts without the limits of nodes, and of the fake nodes in `wire`, which never expire."""

from typing import Any

from rossec.channel.edhoc.credentials import OwnCredential, PeerT, Verify
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.net.context import SecureContext
from tests.support.wire import DEFAULTS, FakeIdentity, trust

LIVE = 1 << 40  # a not_after later than the host's clock


def live(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
    found = trust(chain, now)
    return FakeIdentity(found.name, found.public_key, found.certificate, LIVE)


def unlimited(
    credentials: OwnCredential, verify: Verify[PeerT], limits: ChannelLimits = DEFAULTS, **options: Any
) -> SecureContext[PeerT]:
    """With the channel's own limits, or `limits`, for every protocol: as an attacker has them."""
    every = dict.fromkeys(WireProtocol, limits)
    return SecureContext(credentials, verify, dial_limits=every, accept_limits=every, **options)


def context(
    credentials: OwnCredential,
    verify: Verify[FakeIdentity] = live,
    limits: ChannelLimits = DEFAULTS,
    **options: Any,
) -> SecureContext[FakeIdentity]:
    """An `unlimited` one of a fake node."""
    return unlimited(credentials, verify, limits, **options)
