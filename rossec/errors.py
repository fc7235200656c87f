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
class WireError(RossecError):
    """The peer sent bytes that are not the ROS protocol."""


class HeaderRefused(WireError):
    """A TCPROS connection header that is malformed, ambiguous or too long."""


class FrameRefused(WireError):
    """A TCPROS message longer than allowed."""


class HttpRefused(WireError):
    """HTTP that is malformed, too long, or not a plain XML-RPC exchange.

    `status` is the HTTP status code a server answers with.
    """

    def __init__(self, message: str, hint: str = "", *, status: int = 400) -> None:
        super().__init__(message, hint)
        self.status = status


class XmlRpcRefused(WireError):
    """XML that is not one bounded XML-RPC call or response, or a value XML-RPC cannot carry."""


class AnswerMalformed(WireError):
    """An answer that is not ROS's `[code, status, value]`."""


class AnswerRefused(RossecError):
    """The other side understood the call and said no."""

    def __init__(self, message: str, hint: str = "", *, code: int = -1) -> None:
        super().__init__(message, hint)
        self.code = code


class SettingsRefused(RossecError):
    """The command line or the environment of this program says something that cannot be meant."""
