"""TCPROS in rospy: connection headers of both sides, the admission of peers, and a subscriber's loop.

The header hooks serve services as well: rospy's protocol class determines which right each side has to
prove.
"""

import socket
import struct
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final

import genpy
import genpy.message
import rospy
from rospy.exceptions import TransportInitError
from rospy.impl.registration import get_topic_manager
from rospy.impl.tcpros_pubsub import TCPROSPub, TCPROSSub
from rospy.impl.tcpros_service import TCPROSServiceClient, TCPService

from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import origin_of, shown
from grants.decision import Decision
from grants.errors import DefinitionRefused, GrantError
from grants.guard import Guard
from grants.model import Right
from rossec import clock, peer_limits
from rossec.channel.records import Bytes
from rossec.errors import ChannelClosed, ConnectionHeaderRefused, HeaderRefused, PlainPeer
from rossec.inprocess.identity import LocalIdentity, now, plain_fields
from rossec.inprocess.options import PlainConnection
from rossec.inprocess.process import RosConnection, SecuredProcess
from rossec.inprocess.sockets import ClientFilter, RosSocket, ServerFilter, tried_again
from rossec.net.limits import message_limit, unit_limit
from rossec.participant import definitions, delivery_options, handshakes
from rossec.participant.access import FIELD, granted_name
from rossec.participant.authorized import AuthorizedConnection, memory_scope
from rossec.participant.message_types import MessageType
from rossec.participant.service_types import ServiceGuard, ServiceType
from rossec.ros import names, tcpros
from rossec.ros.tcpros import MESSAGE_LIMIT, FrameReader, Framing

DEADLINE: Final = 5.0
_LENGTH: Final = struct.Struct("<I")
_RIGHTS: Final[dict[type, Right]] = {
    TCPROSSub: Right.SUBSCRIBE,
    TCPROSPub: Right.PUBLISH,
    TCPROSServiceClient: Right.CALL,
    TCPService: Right.PROVIDE,
}
_HINT_PLAIN: Final = "secure it, or name what it offers in allow_plain while you migrate"
_FIRST_PAUSE: Final = 0.5
_LONGEST_PAUSE: Final = 30.0
_SLICE: Final = 0.5  # seconds between checks whether the subscriber is still in use


def definition_of(kind: Any) -> definitions.Definition:
    return definitions.Definition(kind._type, kind._md5sum, kind._full_text)  # noqa: SLF001 - genpy's


def installed_definition(name: str) -> definitions.Definition | None:
    try:
        kind = genpy.message.get_message_class(name)
    except Exception:  # noqa: BLE001 - an import may fail in any way; then it is not installed
        return None
    return None if kind is None else definition_of(kind)


def max_message_size(kind: Any) -> int:
    return message_limit(definitions.size_of(definition_of(kind)), MESSAGE_LIMIT)


def max_unit_size(kind: Any) -> int:
    return unit_limit(definitions.size_of(definition_of(kind)), MESSAGE_LIMIT)


def receive(sock: RosSocket) -> dict[str, bytes]:
    # Whole, within a deadline, and within a limit that is checked before anything is buffered.
    end = time.monotonic() + DEADLINE
    (length,) = _LENGTH.unpack(_exactly(sock, _LENGTH.size, end))
    if length > tcpros.HEADER_LIMIT:
        raise HeaderRefused(f"a connection header of {length} bytes")
    return tcpros.decode(_exactly(sock, length, end))


def _exactly(sock: RosSocket, size: int, end: float) -> bytes:
    data = b""
    try:
        while len(data) < size:
            sock.settimeout(max(0.001, end - time.monotonic()))
            part = sock.stream.recv(size - len(data))
            if not part:
                raise ChannelClosed("the peer closed the connection before its header")
            data += part
    finally:
        sock.settimeout(None)
    return data


def for_rospy(fields: Mapping[str, bytes]) -> dict[str, str]:
    # Without the grants, which are binary: rospy expects text.
    return {key: value.decode(errors="replace") for key, value in fields.items() if key != FIELD}


def refuse(sock: RosSocket, error: HintedError) -> None:
    sock.settimeout(DEADLINE)
    with suppress(HintedError, OSError):
        sock.send_unit(tcpros.error_header(f"rossec: {peer_limits.printable(error)}"))


class Connections:
    def __init__(self, process: SecuredProcess) -> None:
        self._process = process

    @property
    def _local_identity(self) -> LocalIdentity:
        return self._process.local_identity

    # -- headers

    def write_header(self, transport: Any) -> None:
        sock, protocol = transport.socket, transport.protocol
        if sock is None or protocol is None:
            return
        try:
            if sock.is_plain and names.is_forwarded_port(str(transport.endpoint_id)):
                raise PlainPeer("the peer behind a relay is a plain ROS node", _HINT_PLAIN)
            data = tcpros.encode(self._fields(protocol, sock))
            with tried_again():
                sock.send_unit(data)
        except HintedError as error:
            raise self._init_error(protocol, error, sock) from error
        transport.stat_bytes += len(data)

    def _fields(self, protocol: Any, sock: RosSocket) -> dict[str, str | bytes]:
        if sock.is_plain:
            if not self._process.allows_plain(protocol.resolved_name, sock.getpeername()[0]):
                raise PlainPeer("the peer is a plain ROS node", _HINT_PLAIN)
            return dict(protocol.get_header_fields())
        # The peer is judged before it is sent anything.
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
        return {**stock, **named, "callerid": caller, FIELD: proof, **sock.options.fields}

    def read_header(self, transport: Any) -> None:
        sock, protocol = transport.socket, transport.protocol
        if sock is None or protocol is None:
            return
        try:
            with tried_again():
                fields = receive(sock)
            # The right first, and rospy's own checks only on what is left of the header.
            connection = None
            if not sock.is_plain:
                connection = self._admit_server(protocol, fields, sock)
                fields = handshakes.fields_here(fields, sock.peer, protocol.resolved_name)
            transport._validate_header(for_rospy(fields))  # noqa: SLF001 - rospy's own
            if connection is not None:
                self._process.add_connection(sock, connection)
                if isinstance(protocol, TCPROSSub):
                    uri = str(transport.endpoint_id)
                    self._process.follows(sock, protocol.resolved_name, uri)
        except HintedError as error:
            raise self._init_error(protocol, error, sock) from error
        self._process.reporter.forget(_description(protocol))

    def _admit_server(self, protocol: Any, fields: dict[str, bytes], sock: RosSocket) -> RosConnection:
        access, peer = self._local_identity.access, sock.peer
        name = _granted_name(protocol, peer, protocol.resolved_name)
        if isinstance(protocol, TCPROSServiceClient):
            decision = handshakes.admit_provider(fields, peer, name, access, now())
            kind = protocol.service_class
            if decision.restrictions:
                guard = self._service_guard(kind, decision)
                sock.service_filter = ClientFilter(guard, clock.time)
            sock.raise_unit_limit(max_unit_size(kind._response_class))  # noqa: SLF001 - rospy's
            return AuthorizedConnection(sock, decision, None, partial(self._refilter, sock, kind))
        subscribed = definition_of(protocol.recv_data_class)
        decision = handshakes.admit_publisher(fields, peer, name, subscribed, access, now())
        delivery_options.accepted_options(fields, delivery_options.NO_OPTIONS)
        claimed = definitions.from_header(fields)

        def kind_under(decision: Decision) -> definitions.Definition:
            return definitions.receiver_definition(subscribed, claimed, decision, installed_definition)

        def guard_under(decision: Decision) -> Guard | None:
            return self._guard_for(kind_under(decision), decision)

        fields |= definitions.definition_fields(kind_under(decision), decision)
        sock.raise_unit_limit(max_unit_size(protocol.recv_data_class))
        return AuthorizedConnection(sock, decision, guard_under(decision), guard_under)

    def _guard_for(self, kind: definitions.Definition, decision: Decision) -> Guard | None:
        local_identity = self._local_identity
        return definitions.guard_for(
            kind, decision, local_identity.home.filter_key, memory_scope(local_identity.name)
        )

    def _init_error(self, protocol: Any, error: HintedError, sock: RosSocket) -> TransportInitError:
        if not sock.closed_locally:
            self._process.reporter.warn(_description(protocol), error)
        return TransportInitError(f"rossec: {error}")

    # -- callers

    def serve(self, server: Any, sock: RosSocket, where: Any) -> None:
        caller = f"the caller from {where[0]}"
        try:
            if self._process.plain and self._serve_plain(server, sock, where):
                return
            # In the table before it is judged: a revocation that arrives meanwhile finds it there.
            peer = sock.handshake()
            caller = shown(peer.name)
            self._process.connections.accept(sock, peer)
            self._local_identity.access.check_peer(peer, now())
            fields = receive(sock)
            self._admit_caller(server, sock, where, fields)
        except HintedError as error:
            self._process.reporter.warn(f"refused {caller}", error)
            # Whoever is not authenticated is told nothing.
            if sock.is_plain or sock.stream.peer is not None:
                refuse(sock, error)
            sock.close()
        except (OSError, TransportInitError) as error:
            self._process.reporter.warn(f"lost {caller}", error)
            sock.close()
        except BaseException:
            sock.close()  # a check that crashes admits no peer
            raise

    def _serve_plain(self, server: Any, sock: RosSocket, where: Any) -> bool:
        # Read without consuming it: a caller that is not named goes on with the handshake, which refuses it.
        fields = plain_fields(sock.peek())
        kind = "service" if "service" in fields else "topic"
        name = fields.get(kind, b"").decode(errors="replace")
        if not name or not self._process.allows_plain(name, where[0]):
            return False
        sock.switch_to_plain()
        self._process.connections.accept(sock, where[0])
        receive(sock)
        sock.connection = PlainConnection()
        handler = getattr(server, f"{kind}_connection_handler")
        refusal = handler(sock, where, for_rospy(fields))
        if refusal:
            raise ConnectionHeaderRefused(f"no such {kind}, or of another type")
        return True

    def _admit_caller(self, server: Any, sock: RosSocket, where: Any, fields: dict[str, bytes]) -> None:
        access = self._local_identity.access
        if "service" in fields:
            decision = handshakes.admit_caller(fields, sock.peer, access, now())
            connection: RosConnection = AuthorizedConnection(sock, decision, None)
            self._filter_calls(handshakes.requested_service(fields), sock, connection)
            handler = server.service_connection_handler
        else:
            decision = handshakes.admit_subscriber(fields, sock.peer, access, now())
            topic = handshakes.requested_topic(fields)
            published = get_topic_manager().get_publisher_impl(topic)
            if published is None or published.closed:
                raise ConnectionHeaderRefused(f"{self._local_identity.name} does not publish {topic}")
            kind = definition_of(published.data_class)
            options = delivery_options.carried_out(delivery_options.requested_options(fields), decision)
            # Without a queue a publisher waits for each subscriber: no option is taken then.
            sock.options = delivery_options.NO_OPTIONS if published.queue_size is None else options

            def guard_under(decision: Decision) -> Guard | None:
                delivery_options.check_carried_out(sock.options, decision)
                return self._guard_for(kind, decision)

            connection = AuthorizedConnection(sock, decision, guard_under(decision), guard_under)
            handler = server.topic_connection_handler
        self._process.add_connection(sock, connection)
        refusal = handler(sock, where, for_rospy(handshakes.fields_here(fields, sock.peer)))
        if refusal:
            raise ConnectionHeaderRefused(str(refusal), "both sides need the same version of the package")

    def _filter_calls(self, service: str, sock: RosSocket, connection: RosConnection) -> None:
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
        sock.service_filter = ServerFilter(check, guard, refused, clock.time, max_message_size(request_class))
        connection.rebuild = partial(self._refilter, sock, provided.service_class)

    def _refilter(self, sock: RosSocket, kind: Any, decision: Decision) -> None:
        calls = sock.service_filter
        # What passed unread has no known beginnings of calls: the connection is made anew.
        if calls is None and decision.restrictions:
            raise ConnectionHeaderRefused("calls that are restricted now were passed on unread")
        if calls is not None:
            restricted = bool(decision.restrictions)
            calls.guard = self._service_guard(kind, decision) if restricted else None

    def _service_guard(self, kind: Any, decision: Decision) -> ServiceGuard:
        request, response = (
            MessageType(part._type, part._md5sum, part._full_text)  # noqa: SLF001 - rospy's
            for part in (kind._request_class, kind._response_class)  # noqa: SLF001 - rospy's
        )
        # What is filtered by a definition must be what rospy serializes by.
        both = ServiceType(kind._type, request, response)  # noqa: SLF001 - rospy's
        if both.md5sum != kind._md5sum:  # noqa: SLF001 - rospy's
            raise DefinitionRefused(f"the definition of {kind._type} is not that of its messages")  # noqa: SLF001 - rospy's
        local_identity = self._local_identity
        return ServiceGuard(both, decision, local_identity.home.filter_key, memory_scope(local_identity.name))


def _granted_name(protocol: Any, peer: Identity, name: str) -> str:
    return granted_name(peer, name) if isinstance(protocol, TCPROSSub) else name


def _description(protocol: Any) -> str:
    return f"cannot {_RIGHTS[type(protocol)].label} {shown(protocol.resolved_name)}"


class ServiceProbe(RosSocket):
    """`wait_for_service` in rospy, and `rosservice`: a socket of its own, whose header it writes itself.

    It needs the right of a client, and waits for the answer.
    """

    def __init__(self, process: SecuredProcess, sock: socket.socket) -> None:
        super().__init__(process, sock)
        self._process = process
        self._answer = b""

    def recv(self, size: int) -> bytes:
        if self.is_plain:
            return super().recv(size)
        part, self._answer = self._answer[:size], self._answer[size:]
        return part

    def sendall(self, data: Bytes) -> None:
        local_identity = self._process.local_identity
        fields = tcpros.decode(bytes(data)[4:])
        service = handshakes.text(fields, "service")
        if self.is_plain and self._process.allows_plain(service, self.getpeername()[0]):
            super().sendall(data)
            return
        try:
            local_identity.access.check_peer(self.peer, now())
            proof = handshakes.caller_proof(service, local_identity.access, now())
            named = handshakes.fields_on_wire(fields)
            self.send_unit(tcpros.encode({**named, "callerid": local_identity.name_for(self.peer), **proof}))
            answer = receive(self)
            handshakes.admit_provider(answer, self.peer, service, local_identity.access, now())
            self._answer = tcpros.encode(for_rospy(handshakes.fields_here(answer, self.peer)))
        except HintedError as error:
            self._process.reporter.warn(f"cannot call {shown(service)}", error)
            raise


class SubscriptionLoop:
    """The subscriber's side of a topic: connected to a publisher for as long as the master names it."""

    def __init__(self, process: SecuredProcess) -> None:
        self._process = process

    def run(
        self, conn: Any, host: str, port: int, uri: str, callback: Callable[..., None], topic: str
    ) -> None:
        # `host`, `port`: the publisher's answer, of no use at a relay's forwarded port, where its topics are.
        if names.is_forwarded_port(uri):
            host, port = names.parse_uri(uri)
        pause = _FIRST_PAUSE
        while not conn.done and not rospy.is_shutdown():
            before = conn.stat_num_msg
            try:
                self._process.own_addresses.check_redirect(names.parse_uri(uri), (host, port))
                conn.connect(host, port, uri, timeout=60.0)
                self._receive(conn, callback)
            except TransportInitError:
                pass  # logged where it happened
            except Exception as error:  # noqa: BLE001 - as rospy: no message may end a subscription
                if not conn.done and not rospy.is_shutdown():
                    self._process.reporter.warn(f"lost {conn.name} from {uri}", error)
            if conn.protocol is None:  # closed, by the program or because the port is closed
                break
            self._close_socket(conn)
            if conn.stat_num_msg > before:
                pause = _FIRST_PAUSE
            if not self._wait_for_change(conn, pause, topic, uri):
                break
            pause = min(2 * pause, _LONGEST_PAUSE)
        if not conn.done:
            conn.close()

    def _receive(self, conn: Any, callback: Callable[..., None]) -> None:
        sock, protocol = conn.socket, conn.protocol
        if sock is None or protocol is None:
            return
        framing = Framing(FrameReader(max_message_size(protocol.recv_data_class)))
        make, limit = protocol.recv_data_class, protocol.queue_size or 0
        while not conn.done and not rospy.is_shutdown():
            unit = sock.receive_before_deadline(framing, sock.stream.receive_unit)
            if not unit:
                return
            conn.stat_bytes += len(unit)
            received = self._filter(sock.connection, framing.feed(unit, now()))
            messages = [make().deserialize(data) for data in received[-limit:]]
            del unit, received  # their memory is used for the next one
            if not messages:
                continue
            conn.stat_num_msg += len(messages)
            for message in messages:
                message._connection_header = conn.header  # noqa: SLF001 - part of rospy's messages
            if conn.is_latched:
                conn.latch = messages[-1]
            callback((each for each in messages if not sock.aborted), conn)

    def _filter(
        self, connection: RosConnection | PlainConnection | None, messages: list[bytes]
    ) -> list[bytes]:
        guard = None if connection is None else connection.guard  # may be replaced meanwhile
        if connection is None or guard is None or isinstance(connection, PlainConnection):
            return messages
        filtered = []
        for message in messages:
            try:
                content = guard(message, clock.time())
            except GrantError as error:
                self._process.reporter.warn(f"withheld a message on {shown(connection.decision.name)}", error)
            else:
                filtered += [] if content is None else [b"".join(content)]
        return filtered

    @staticmethod
    def _close_socket(conn: Any) -> None:
        sock, conn.socket = conn.socket, None
        if sock is not None:
            sock.close()

    def _wait_for_change(self, conn: Any, pause: float, topic: str, uri: str) -> bool:
        end = time.monotonic() + pause
        membership = self._process.membership
        seen = membership.rights_version
        while seen == membership.rights_version and time.monotonic() < end:
            if conn.done or rospy.is_shutdown():
                return False
            time.sleep(min(_SLICE, max(0.0, end - time.monotonic())))
        return self._process.registrations.is_publisher(topic, uri)
