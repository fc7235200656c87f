"""Every way the running system can refuse.

The leaves say whose fault it is: the peer's protocol, the peer's identity, the operator's
configuration, or the network.
"""

from ca.errors import HintedError


class RossecError(HintedError):
    """Root of everything `rossec` refuses."""


class ChannelError(RossecError):
    """The secure connection cannot be made, or has ended."""


class ChannelClosed(ChannelError):
    """The connection was closed in order, by this side or by the peer's authenticated close."""


class PeerUnreachable(ChannelError):
    """No TCP connection could be made to the peer."""


class HandshakeFailed(ChannelError):
    """The peer's handshake is malformed, or its proof does not hold."""


class HandshakeTimeout(HandshakeFailed):
    """The peer did not finish the handshake in time."""


class IdentityRefused(HandshakeFailed):
    """The peer speaks the protocol, but its certificate was not accepted."""


class PeerRefused(ChannelError):
    """The peer ended the handshake with an error. Unauthenticated, so only a hint."""


class PlainPeer(ChannelError):
    """The peer speaks ROS, but not through rossec."""


class ProtocolViolation(ChannelError):
    """A frame or message which the state machine does not allow here."""


class RecordForged(ChannelError):
    """A record did not verify: altered, replayed, reordered or left out."""


class ConnectionTruncated(ChannelError):
    """The connection ended without the peer's authenticated close."""


class LimitExceeded(ChannelError):
    """A size, rate or lifetime limit of the channel was reached."""


class IdentityExpired(LimitExceeded):
    """The peer's certificate ran out while the connection was open."""


class SendQueueFull(LimitExceeded):
    """The peer reads slower than this side queues; nothing was queued."""
