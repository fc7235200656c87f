"""Every way the running system can refuse.

The leaves say whose fault it is: the peer's protocol, the peer's identity, the operator's
configuration, or the network.
"""

from ca.errors import HintedError


class RossecError(HintedError):
    """Root of everything `rossec` refuses."""


class MessageError(RossecError):
    """A message type that is unknown, or a message that does not fit its type."""


class ConfigurationError(RossecError):
    """Something the operator has to set right: a name, a file, an environment variable."""


class TopicRefused(RossecError):
    """A peer's TCPROS header that does not fit what this node publishes or subscribes."""


class CallerMismatch(TopicRefused):
    """A peer that calls itself by another name than its certificate says."""


class NodeShutdown(RossecError):
    """The node is closed, or the master told it to shut down."""


class NotDelivered(RossecError):
    """Done here, but the master could not be told."""
