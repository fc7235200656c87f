"""TCPROS in rospy: connection headers of both sides, and the admission of peers.

The header hooks serve services as well: rospy's protocol class determines which right
each side has to prove.
"""

from functools import partial
from typing import Any, Final

import rospy
from rospy.exceptions import TransportInitError
from rospy.impl.registration import get_topic_manager
from rospy.impl.tcpros_pubsub import TCPROSPub, TCPROSSub
from rospy.impl.tcpros_service import TCPROSServiceClient, TCPService

from ca.certificates import Identity
from ca.domains.aliases import origin_of, shown
from ca.errors import HintedError
from grants.decision import Decision
from grants.errors import DefinitionRefused
from grants.guard import Guard
from grants.model import Right
from rossec import clock
from rossec.errors import ConnectionHeaderRefused, PlainPeer
from rossec.inprocess import headers
from rossec.inprocess.allow_plain import PlainConnection
from rossec.inprocess.genpy_types import (
    definition_of,
    installed_definition,
    max_message_size,
    max_unit_size,
)
from rossec.inprocess.identity import LocalIdentity, now
from rossec.inprocess.plain_stream import plain_fields
from rossec.inprocess.process import RosConnection, SecuredProcess
from rossec.inprocess.service_filter import ClientFilter, ServerFilter
from rossec.inprocess.socket_errors import tried_again
from rossec.inprocess.sockets import RosSocket
from rossec.participant.access import FIELD
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.definitions import (
    Definition,
    definition_fields,
    from_header,
    receiver_definition,
)
from rossec.participant.limit_memory import memory_scope
from rossec.participant.message_types import MessageType
from rossec.participant.remote_names import fields_here
from rossec.participant.service_guard import ServiceGuard
from rossec.participant.service_handshake import admit_caller, admit_provider, requested_service
from rossec.participant.service_types import ServiceType
from rossec.participant.topic_guard import guard_for
from rossec.participant.topic_handshake import (
    ExpectedTopic,
    admit_publisher,
    admit_subscriber,
    requested_topic,
)
from rossec.participant.wire_names import granted_name
from rossec.participant.wishes import (
    NO_WISHES,
    carried_out,
    check_carried_out,
    requested_wishes,
    taken_wishes,
)
from rossec.ros import header
from rossec.ros.settings import is_door

_RIGHTS: Final[dict[type, Right]] = {
    TCPROSSub: Right.SUBSCRIBE,
    TCPROSPub: Right.PUBLISH,
    TCPROSServiceClient: Right.CALL,
    TCPService: Right.PROVIDE,
}
_HINT_PLAIN: Final = "secure it, or name what it offers in allow_plain while you migrate"


class Connections:
    """The hooks of one process. Their arguments are those of the functions they replace."""

    def __init__(self, process: SecuredProcess) -> None:
        self._process = process

    @property
    def _local_identity(self) -> LocalIdentity:
        return self._process.local_identity

    # -- headers

    def write_header(self, transport: Any) -> None:
        """`TCPROSTransport.write_header`."""
        sock, protocol = transport.socket, transport.protocol
        if sock is None or protocol is None:
            return
        try:
            if sock.is_plain and is_door(str(transport.endpoint_id)):
                raise PlainPeer("the peer behind a relay is a plain ROS node", _HINT_PLAIN)
            data = header.encode(self._fields(protocol, sock))
            with tried_again():
                sock.send_unit(data)
        except HintedError as error:
            raise self._init_error(protocol, error, sock) from error
        transport.stat_bytes += len(data)

    def _fields(self, protocol: Any, sock: RosSocket) -> dict[str, str | bytes]:
        if sock.is_plain:
            self._check_plain(protocol.resolved_name, sock)
            return dict(protocol.get_header_fields())
        self._local_identity.access.check_peer(sock.peer, now())
        name = _granted_name(protocol, sock.peer, protocol.resolved_name)
        proof = self._local_identity.access.present(_RIGHTS[type(protocol)], name, now())
        stock = protocol.get_header_fields()
        named = {
            key: origin_of(_granted_name(protocol, sock.peer, stock[key]))
            for key in ("topic", "service")
            if key in stock
        }
        caller = self._local_identity.name_for(sock.peer)
        return {**stock, **named, "callerid": caller, FIELD: proof, **sock.wishes.fields}

    def _check_plain(self, name: str, sock: RosSocket) -> None:
        """Checked before the first plain byte is sent."""
        if not self._process.allows_plain(name, sock.getpeername()[0]):
            raise PlainPeer("the peer is a plain ROS node", _HINT_PLAIN)

    def read_header(self, transport: Any) -> None:
        """`TCPROSTransport.read_header`: the answer of a publisher or a service."""
        sock, protocol = transport.socket, transport.protocol
        if sock is None or protocol is None:
            return
        try:
            with tried_again():
                fields = headers.receive(sock)
            connection = None
            if not sock.is_plain:
                connection = self._admit_server(protocol, fields, sock)
                fields = fields_here(fields, sock.peer, protocol.resolved_name)
            transport._validate_header(headers.for_rospy(fields))  # noqa: SLF001 - rospy's own
            if connection is not None:
                self._process.add_connection(sock, connection)
                if isinstance(protocol, TCPROSSub):
                    uri = str(transport.endpoint_id)
                    self._process.follows(sock, protocol.resolved_name, uri)
        except HintedError as error:
            raise self._init_error(protocol, error, sock) from error
        self._process.reporter.forget(_description(protocol))

    def _admit_server(
        self, protocol: Any, fields: dict[str, bytes], sock: RosSocket
    ) -> RosConnection:
        access, peer = self._local_identity.access, sock.peer
        name = _granted_name(protocol, peer, protocol.resolved_name)
        if isinstance(protocol, TCPROSServiceClient):
            decision = admit_provider(fields, peer, name, access, now())
            kind = protocol.service_class
            if decision.restrictions:
                guard = self._service_guard(kind, decision)
                sock.service_filter = ClientFilter(guard, clock.time)
            sock.raise_unit_limit(max_unit_size(kind._response_class))  # noqa: SLF001 - rospy's
            return AuthorizedConnection(sock, decision, None, partial(self._refilter, sock, kind))
        subscribed = definition_of(protocol.recv_data_class)
        expected = ExpectedTopic(name, subscribed.name, subscribed.md5sum)
        decision = admit_publisher(fields, peer, expected, access, now())
        taken_wishes(fields, NO_WISHES)
        claimed = from_header(fields)

        def kind_under(decision: Decision) -> Definition:
            return receiver_definition(subscribed, claimed, decision, installed_definition)

        def guard_under(decision: Decision) -> Guard | None:
            return self._guard_for(kind_under(decision), decision)

        fields |= definition_fields(kind_under(decision), decision)
        sock.raise_unit_limit(max_unit_size(protocol.recv_data_class))
        return AuthorizedConnection(sock, decision, guard_under(decision), guard_under)

    def _guard_for(self, kind: Definition, decision: Decision) -> Guard | None:
        local_identity = self._local_identity
        return guard_for(
            kind, decision, local_identity.home.filter_key, memory_scope(local_identity.name)
        )

    def _init_error(self, protocol: Any, error: HintedError, sock: RosSocket) -> TransportInitError:
        if not sock.closed_locally:
            self._process.reporter.warn(_description(protocol), error)
        return TransportInitError(f"rossec: {error}")

    # -- callers

    def serve(self, server: Any, sock: RosSocket, where: Any) -> None:
        """`TCPROSServer._tcp_server_callback`, in a thread of its own: one caller."""
        caller = f"the caller from {where[0]}"
        try:
            if self._process.plain and self._serve_plain(server, sock, where):
                return
            peer = sock.handshake()
            caller = shown(peer.name)
            self._process.connections.accept(sock, peer, sock.abort)
            self._local_identity.access.check_peer(peer, now())
            fields = headers.receive(sock)
            self._admit_caller(server, sock, where, fields)
        except HintedError as error:
            self._process.reporter.warn(f"refused {caller}", error)
            if sock.is_plain or sock.stream.peer is not None:
                headers.refuse(sock, error)
            sock.close()
        except (OSError, TransportInitError) as error:
            self._process.reporter.warn(f"lost {caller}", error)
            sock.close()
        except BaseException:
            sock.close()  # a check that crashes admits no peer
            raise

    def _serve_plain(self, server: Any, sock: RosSocket, where: Any) -> bool:
        """Serve a plain caller of what `allow_plain` names; others continue with the handshake."""
        fields = plain_fields(sock.peek())
        kind = "service" if "service" in fields else "topic"
        name = fields.get(kind, b"").decode(errors="replace")
        if not name or not self._process.allows_plain(name, where[0]):
            return False
        sock.switch_to_plain()
        self._process.connections.accept(sock, where[0], sock.abort)
        headers.receive(sock)
        sock.connection = PlainConnection()
        handler = getattr(server, f"{kind}_connection_handler")
        refusal = handler(sock, where, headers.for_rospy(fields))
        if refusal:
            raise ConnectionHeaderRefused(f"no such {kind}, or of another type")
        return True

    def _admit_caller(
        self, server: Any, sock: RosSocket, where: Any, fields: dict[str, bytes]
    ) -> None:
        access = self._local_identity.access
        if "service" in fields:
            decision = admit_caller(fields, sock.peer, access, now())
            connection: RosConnection = AuthorizedConnection(sock, decision, None)
            self._filter_calls(requested_service(fields), sock, connection)
            handler = server.service_connection_handler
        else:
            decision = admit_subscriber(fields, sock.peer, access, now())
            published = self._published(requested_topic(fields))
            kind = definition_of(published.data_class)
            wishes = carried_out(requested_wishes(fields), decision)
            sock.wishes = NO_WISHES if published.queue_size is None else wishes

            def guard_under(decision: Decision) -> Guard | None:
                check_carried_out(sock.wishes, decision)
                return self._guard_for(kind, decision)

            connection = AuthorizedConnection(sock, decision, guard_under(decision), guard_under)
            handler = server.topic_connection_handler
        self._process.add_connection(sock, connection)
        refusal = handler(sock, where, headers.for_rospy(fields_here(fields, sock.peer)))
        if refusal:
            raise ConnectionHeaderRefused(
                str(refusal), "both sides need the same version of the package"
            )

    def _filter_calls(self, service: str, sock: RosSocket, connection: RosConnection) -> None:
        """Filter the calls of this caller.

        Raises:
            ConnectionHeaderRefused: the service is not provided here.
            GrantError: the restrictions do not fit its type.
        """
        provided = rospy.impl.registration.get_service_manager().get_service(service)
        if provided is None:
            raise ConnectionHeaderRefused(f"{self._local_identity.name} does not provide {service}")
        guard = None
        if connection.decision.restrictions:
            guard = self._service_guard(provided.service_class, connection.decision)

        def refused(error: HintedError) -> None:
            self._process.reporter.warn(f"{service}: refused {shown(sock.peer.name)}", error)

        request_class = provided.service_class._request_class  # noqa: SLF001 - rospy's
        sock.raise_unit_limit(max_unit_size(request_class))
        check = partial(self._process.connections.check, connection)
        sock.service_filter = ServerFilter(
            check, guard, refused, clock.time, max_message_size(request_class)
        )
        connection.rebuild = partial(self._refilter, sock, provided.service_class)

    def _refilter(self, sock: RosSocket, kind: Any, decision: Decision) -> None:
        """Another decision is in force for the calls on this connection.

        Raises:
            HintedError: it cannot be applied to them.
        """
        calls = sock.service_filter
        if calls is None and decision.restrictions:
            raise ConnectionHeaderRefused("calls that are restricted now were passed on unread")
        if calls is not None:
            restricted = bool(decision.restrictions)
            calls.replace_guard(self._service_guard(kind, decision) if restricted else None)

    def _service_guard(self, kind: Any, decision: Decision) -> ServiceGuard:
        request, response = (
            MessageType(part._type, part._md5sum, part._full_text)  # noqa: SLF001 - rospy's
            for part in (kind._request_class, kind._response_class)  # noqa: SLF001 - rospy's
        )
        both = ServiceType(kind._type, request, response)  # noqa: SLF001 - rospy's
        if both.md5sum != kind._md5sum:  # noqa: SLF001 - rospy's
            raise DefinitionRefused(f"the definition of {kind._type} is not that of its messages")  # noqa: SLF001 - rospy's
        local_identity = self._local_identity
        return ServiceGuard(
            both, decision, local_identity.home.filter_key, memory_scope(local_identity.name)
        )

    def _published(self, topic: str) -> Any:
        """The publisher of a topic.

        Raises:
            ConnectionHeaderRefused: the topic is not published here.
        """
        published = get_topic_manager().get_publisher_impl(topic)
        if published is None or published.closed:
            raise ConnectionHeaderRefused(f"{self._local_identity.name} does not publish {topic}")
        return published


def _granted_name(protocol: Any, peer: Identity, name: str) -> str:
    """The local name whose grants decide on `name`, which the protocol is about, with `peer`."""
    return granted_name(peer, name) if isinstance(protocol, TCPROSSub) else name


def _description(protocol: Any) -> str:
    return f"cannot {_RIGHTS[type(protocol)].label} {shown(protocol.resolved_name)}"
