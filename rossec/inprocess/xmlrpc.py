"""XML-RPC in rospy, both sides: calls to the master and to other nodes, and this node's own API.

Calls to the master go over the guardian's session. Calls and answers are parsed by `rossec.ros`,
within its limits, never by the standard library's server. Errors are those rospy knows: OSError.
"""

import errno
import logging
import socket
import time
import xmlrpc.client
from contextlib import suppress
from typing import Any, Final

from rospy.impl.tcpros_base import get_tcpros_server_address, start_tcpros_server

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from rossec.channel.opening import REFUSAL, Flavour
from rossec.errors import ChannelClosed, ChannelError, HttpRefused, PlainPeer, XmlRpcRefused
from rossec.inprocess.addresses import bracketed
from rossec.inprocess.member import now
from rossec.inprocess.plainsocket import PlainStream, peek
from rossec.inprocess.process import Process
from rossec.inprocess.registrations import REFUSED
from rossec.inprocess.sockets import CONNECT_TIMEOUT, Stream
from rossec.net.rpc import CALL_DEADLINE, REQUEST_DEADLINE
from rossec.node.listener import SLAVE_DEADLINE
from rossec.node.slave import MASTER, REVOCATION_UPDATE, refusal, topic_offer
from rossec.ros.http import HttpClient, HttpServer
from rossec.ros.settings import parse_uri
from rossec.ros.xmlrpc import Fault, dump_call, dump_response, load_call, load_response

_MULTICALL: Final = "system.multicall"
_WITH_SERVICE_URI: Final = ("registerService", "unregisterService")
_FAULT_CODE: Final = 1
_READ: Final = 64 * 1024
_log = logging.getLogger("rossec.rospy")

Params = tuple[Any, ...]


class Client:
    """The calling side of one process."""

    def __init__(self, process: Process) -> None:
        self._process = process

    def proxy_class(self) -> type[xmlrpc.client.ServerProxy]:
        """What rospy is given for `xmlrpc.client.ServerProxy`; several threads may share one."""
        client = self

        class SecureProxy(xmlrpc.client.ServerProxy):
            """Calls over the secure channel."""

            def __init__(self, uri: str, *_: Any, **__: Any) -> None:
                super().__init__(uri)
                self._rossec_uri = uri

            def _ServerProxy__request(self, method: str, params: Params) -> Any:  # noqa: N802 - the base's name
                return client.call(self._rossec_uri, method, params)

        return SecureProxy

    def call(self, uri: str, method: str, params: Params) -> object:
        """The value a node answers.

        Raises:
            Fault: it answered with a fault.
            OSError: it cannot be reached, or is not who it must be.
        """
        address = parse_uri(uri)
        if address == self._process.guardian.address:
            return self._call_master(method, params)
        try:
            return _stock(self._call_node(address, method, params))
        except PlainPeer as error:  # it will not change: rospy tries again when it is refused thus
            raise ConnectionRefusedError(errno.ECONNREFUSED, self._refused(uri, error)) from error
        except HintedError as error:
            raise ConnectionAbortedError(errno.ECONNABORTED, self._refused(uri, error)) from error

    def _refused(self, uri: str, error: HintedError) -> str:
        self._process.reporter.warn(f"cannot call {uri}", error)
        return f"rossec: {error}"

    # -- the master

    def _call_master(self, method: str, params: Params) -> object:
        own = self._with_own_name(method, params)
        answer = _stock(self._process.guardian.call(method, own))
        if method == _MULTICALL:
            for call in own[0]:
                self._process.registrations.note(call["methodName"], call["params"], [1, "", 0])
            return answer
        return self._noted(method, own, answer)

    def _with_own_name(self, method: str, params: Params) -> Params:
        """Tools and early calls give other names than the node's; the master knows the node."""
        name = self._process.member.name
        if method == _MULTICALL:
            calls = [{**call, "params": [name, *call["params"][1:]]} for call in params[0]]
            return (calls,)
        if method in _WITH_SERVICE_URI and isinstance(params[2], str):
            params = (*params[:2], bracketed(params[2]), *params[3:])
        return (name, *params[1:]) if params else params

    def _noted(self, method: str, params: Params, answer: object) -> object:
        registrations = self._process.registrations
        registrations.note(method, params, answer)
        match answer:
            case [code, str(status), _] if code != 1 and status.startswith(REFUSED):
                if registrations.is_rospys_own(method, params):
                    _log.info("rospy's own %s is refused: %s", method, status)
                    return [1, status, 0] if method.startswith("register") else answer
                about = status.removeprefix(REFUSED)
                self._process.reporter.warn(f"the master refuses {method}: {about}")
            case _:
                pass
        return answer

    # -- other nodes

    def _call_node(self, address: tuple[str, int], method: str, params: Params) -> object:
        request = dump_call(method, params)
        sock = socket.create_connection(address, CONNECT_TIMEOUT)
        try:
            stream = self._process.doors.call(sock, Flavour.HTTP)
        except PlainPeer:
            if not self._process.plain or method != "requestTopic":
                raise
            return self._call_plain(address, params, request)
        try:
            if stream.peer is not None:
                self._process.member.access.check_peer(stream.peer, now())
            return load_response(_exchange(stream, address[0], request))
        finally:
            stream.close()

    def _call_plain(self, address: tuple[str, int], params: Params, request: bytes) -> object:
        sock = socket.create_connection(address, CONNECT_TIMEOUT)
        with sock:
            if not self._process.may_be_plain(str(params[1]), sock.getpeername()[0]):
                raise PlainPeer("the peer is a plain ROS node", "secure it, or see allow_plain")
            return load_response(_exchange(PlainStream(sock), address[0], request))


def _exchange(stream: Stream | PlainStream, host: str, request: bytes) -> bytes:
    http = HttpClient(f"[{host}]" if ":" in host else host)
    end = time.monotonic() + CALL_DEADLINE
    stream.settimeout(CALL_DEADLINE)
    stream.sendall(http.request(request))
    while (body := http.next_response()) is None:
        http.feed(_some(stream, end))
    return body


def _some(stream: Stream | PlainStream, end: float | None) -> bytes:
    stream.settimeout(None if end is None else max(0.001, end - time.monotonic()))
    data = stream.recv(_READ)
    if not data:
        raise ChannelClosed("the peer closed the connection")
    return data


def _stock(value: Any) -> Any:
    """The types that stock's clients give a program."""
    if isinstance(value, bytes):
        return xmlrpc.client.Binary(value)
    if isinstance(value, list):
        return [_stock(item) for item in value]
    if isinstance(value, dict):
        return {key: _stock(item) for key, item in value.items()}
    return value


class Server:
    """This node's API: who may call what is `rossec.node.slave`'s."""

    def __init__(self, process: Process) -> None:
        self._process = process

    def verify_request(self, _server: Any, _request: socket.socket, where: Any) -> bool:
        """`ThreadingXMLRPCServer.verify_request`, before a thread is spent on a caller."""
        return self._process.doors.admit(where[0])

    def finish_request(self, server: Any, request: socket.socket, where: Any) -> None:
        """`ThreadingXMLRPCServer.finish_request`, in a thread of its own: one caller."""
        if self._process.plain and peek(request) == b"POST":
            try:
                self._answer_plain(request, where[0])
            finally:
                self._process.doors.settle(where[0])
            return
        stream = self._process.doors.answer(request, where[0], Flavour.HTTP)
        caller = f"the caller from {where[0]}"
        try:
            peer = stream.do_handshake()
            caller = peer.name
            self._process.links.admit(stream, peer, stream.shutdown)
            self._serve(server, stream, peer)
        except ChannelClosed:
            pass
        except (HintedError, TimeoutError) as error:
            self._process.reporter.warn(f"refused {caller}", error)
        finally:
            self._process.links.forget(stream)
            stream.close()

    def _serve(self, server: Any, stream: Stream, peer: Identity) -> None:
        """The master's connection stays; another node asks where a topic is, and goes."""
        http = HttpServer()
        end = None if peer.name == MASTER else time.monotonic() + SLAVE_DEADLINE
        try:
            while not http.closing:
                body = _next_request(http, stream, end)
                stream.settimeout(REQUEST_DEADLINE)
                stream.sendall(http.respond(self._answer(server, body, peer)))
        except HttpRefused as error:
            with suppress(ChannelError, OSError):
                stream.sendall(http.refuse(error.status))

    def _answer_plain(self, request: socket.socket, address: str) -> None:
        """A plain caller may ask where a topic is that `allow_plain` names, and nothing else."""
        stream, http = PlainStream(request), HttpServer()
        with suppress(HintedError, OSError):
            call = load_call(_next_request(http, stream, time.monotonic() + REQUEST_DEADLINE))
            match call.method, call.params:
                case "requestTopic", (_, str() as topic, list() as protocols) if (
                    self._process.may_be_plain(topic, address)
                ):
                    start_tcpros_server()
                    answer = topic_offer(protocols, *get_tcpros_server_address())
                case _:
                    answer = [-1, REFUSAL, 0]
            stream.sendall(http.respond(dump_response(answer)))

    def _answer(self, server: Any, body: bytes, peer: Identity) -> bytes:
        try:
            call = load_call(body)
            return dump_response(self._value(server, call.method, call.params, peer))
        except XmlRpcRefused as error:
            return dump_response(Fault(_FAULT_CODE, str(error)))

    def _value(self, server: Any, method: str, params: Params, peer: Identity) -> object:
        try:
            self._check(method, peer)
            refused = refusal(method, params, peer)
            if refused is not None:
                self._process.reporter.warn(f"refused {peer.name}: {method}: {refused[1]}")
                return refused
            return self._run(server, method, params, peer)
        except HintedError as error:
            self._process.reporter.warn(f"refused {peer.name}: {method}", error)
            return [-1, f"rossec: {error}", 0]
        except Exception:  # noqa: BLE001 - nothing of our inside to a peer
            _log.exception("a call failed inside")
            return Fault(_FAULT_CODE, "rossec: internal error")

    def _check(self, method: str, peer: Identity) -> None:
        """Ask at every call: a peer, also the master, may be revoked while it is connected."""
        try:
            self._process.member.access.check_peer(peer, now())
        except RevocationsStale:
            if method != REVOCATION_UPDATE:  # what ends the staleness must get through
                raise

    def _run(self, server: Any, method: str, params: Params, peer: Identity) -> object:
        if method == REVOCATION_UPDATE:
            self._process.take_revocations(params[1], params[2], peer)
            return [1, "", 0]
        if method == "requestTopic":
            start_tcpros_server()
            return topic_offer(params[2], *get_tcpros_server_address())
        if method == "publisherUpdate":
            self._process.registrations.publishers_are(params[1], params[2])
        return list(server._dispatch(method, params))  # noqa: SLF001 - stock's own handler


def _next_request(http: HttpServer, stream: Stream | PlainStream, end: float | None) -> bytes:
    while (body := http.next_request()) is None:
        waiting = end
        if http.pending:
            begun = time.monotonic() + REQUEST_DEADLINE
            waiting = begun if end is None else min(begun, end)
        http.feed(_some(stream, waiting))
    return body
