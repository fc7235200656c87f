"""The errors of the running system; leaves name the cause: a peer, its protocol, the operator, the net."""

from ca.errors import HintedError


class RossecError(HintedError):
    """Root of the errors of `rossec`."""


class MessageError(RossecError):
    """A message type that is unknown, or a message that does not fit its type."""


class ConfigurationError(RossecError):
    """A mistake the operator has to correct: a name, a file, an environment variable."""


class NotWritten(RossecError):
    """A file that could not be written; the old content is unchanged."""


class ConnectionHeaderRefused(RossecError):
    """A peer's TCPROS header that does not fit what this node publishes or subscribes."""


class HangUp(RossecError):
    """Close the connection without an answer."""


class ServiceUnavailable(RossecError):
    """No node provides the service now."""


class ServiceRefused(RossecError):
    """A request or a response which the grant does not allow."""


class ServiceFailed(RossecError):
    """The provider of a service could not do what was asked; handlers raise it to say why."""


class ParameterUnset(RossecError):
    """A parameter that has no value."""


class NodeShutdown(RossecError):
    """The node is closed, or the master shut it down."""


class NotDelivered(RossecError):
    """Done here, but not delivered to the master."""


class AuthorityLocked(RossecError):
    """The authority's service runs, but does not hold the key now."""


class SigningRefused(RossecError):
    """Bytes that the authority's service does not recognize as something an authority signs."""


class KeyServiceRefused(RossecError):
    """The authority's service refuses for another reason: it is busy, or cannot write its audit."""


class PhoneCodeRefused(RossecError):
    """A one-time code for the console that is wrong, used, too old, or one of too many."""


class FormRefused(RossecError):
    """A form of the console with other fields than its page has, or a field that is no answer."""


class ScannerBusy(RossecError):
    """Another picture is being read."""


class KeyServiceFailed(RossecError):
    """What answers as the authority's service is not it, or the answer is invalid."""


class PolicyContradicted(RossecError):
    """The policy is in force, but grants made by hand allow what it denies."""


class PolicyIncomplete(RossecError):
    """The policy is in force, except for rights of some nodes that cannot be granted."""


class WireError(RossecError):
    """The peer sent bytes that are not the ROS protocol."""


class HeaderRefused(WireError):
    """A TCPROS connection header that is malformed, ambiguous or too long."""


class KeyMessageRefused(WireError):
    """A message to or from the authority's service that is malformed or too long."""


class HttpRefused(WireError):
    """HTTP that is malformed, too long, or not what the server answers.

    `status` is the HTTP status code a server answers with.
    """

    def __init__(self, message: str, hint: str = "", *, status: int = 400) -> None:
        super().__init__(message, hint)
        self.status = status


class XmlRpcRefused(WireError):
    """XML that is not one bounded XML-RPC call or response, or a value XML-RPC cannot carry."""


class CompactRefused(WireError):
    """A unit of calls in the compact form that is malformed, too long or out of its turn."""


class AnswerMalformed(WireError):
    """An answer that is not ROS's `[code, status, value]`."""


class AnswerRefused(RossecError):
    """The other side understood the call and refused it."""

    def __init__(self, message: str, hint: str = "", *, code: int = -1) -> None:
        super().__init__(message, hint)
        self.code = code


class ImportRefused(RossecError):
    """Facts or parameters of another master that this one does not take over."""


class PeerUserRefused(RossecError):
    """A program of another user of this host, or of an unknown user."""


class ChannelError(RossecError):
    """The secure connection cannot be made, or has ended."""


class ChannelClosed(ChannelError):
    """The connection was closed in order, by this side or by the peer's authenticated close."""


class PeerUnreachable(ChannelError):
    """No TCP connection could be made to the peer."""


class HandshakeFailed(ChannelError):
    """The peer's handshake is malformed, or its authentication failed."""


class HandshakeTimeout(HandshakeFailed):
    """The peer did not finish the handshake in time."""


class IdentityRefused(HandshakeFailed):
    """The peer speaks the protocol, but its certificate was not accepted."""


class ForeignIdentity(IdentityRefused):
    """The peer's certificate is signed by an authority that is not trusted here."""


class PeerRefused(ChannelError):
    """The peer ended the handshake with an error. Unauthenticated, so only a hint."""


class PeerCredentialUnknown(HandshakeFailed):
    """The peer named its certificate by an unknown hash; it is answered with error 3."""


class OwnCredentialUnknown(PeerRefused):
    """The peer does not know the hash of this node's certificate: retry, by value."""


class PlainPeer(ChannelError):
    """The peer speaks ROS, but not through rossec."""


class ProtocolViolation(ChannelError):
    """A frame or message which the state machine does not allow here."""


class ConnectionTruncated(ChannelError):
    """The connection ended without the peer's authenticated close."""


class LimitExceeded(ChannelError):
    """A size, rate or lifetime limit of the channel was reached."""


class AnnouncementRefused(RossecError):
    """A datagram that is not a valid announcement of this trust domain's master."""


class MasterNotFound(RossecError):
    """No announcement of a master of this trust domain was received."""


class GraphHidden(RossecError):
    """Another master shows nothing of its graph to this one."""


class SiteRefused(RossecError):
    """Another master than the one to follow, or one that may not be followed from here."""


class OverlayUnavailable(RossecError):
    """The library of the overlay is not installed, or no router can be used."""


class LinkEnded(RossecError):
    """A link through the overlay ended: reset, no progress, or a frame that is malformed."""


class StreamRefused(RossecError):
    """A stream of a link between relays is refused, or breaks its rules."""


class LinkCrowded(StreamRefused):
    """A link between relays has no room for another stream."""


class RelayRefused(RossecError):
    """Another relay, its descriptor or a forwarded port is refused."""


class RulesRefused(RossecError):
    """Rules for names that are malformed, fail, or use what rules may not."""


class MetadataRefused(RossecError):
    """Metadata, or a launch file, that is malformed or too long, or a question about none of it."""


class NameUndefined(RossecError):
    """Rules that give no name for what was asked, or several."""


class ProposedNameRefused(RossecError):
    """A text that rules gave as a name, and that is not one, or a reserved one."""


class RulesExceeded(RossecError):
    """Rules that took more time, memory or output than allowed."""


class RulesNotConfined(RossecError):
    """The process for rules cannot be started here, or cannot be confined."""


class ThingError(RossecError):
    """A constrained thing, or whoever sends to a border router, that does not keep its protocol."""


class DatagramRefused(ThingError):
    """Bytes that are not a CoAP message, or that no key of a thing has protected."""


class BodyRefused(ThingError):
    """The body of a resource that is not a message of its type, or is too long."""


class ThingUnreachable(ThingError):
    """A thing that did not answer in time, or answered with an error."""
