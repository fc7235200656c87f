"""The XML-RPC calls of rospy: to the master, over the guardian's session, and to other nodes.

Calls and answers are parsed by `rossec.ros`, within its limits, never by the standard library.
Errors are those rospy knows: OSError. Before a question about another node, that node is shown the
grants that entitle to ask (`rossec.node.questions`).
"""

import errno
import logging
import socket
import time
import xmlrpc.client
from typing import Any, Final

from ca.errors import HintedError
from rossec.channel.opening import Flavour
from rossec.errors import PlainPeer
from rossec.inprocess.addresses import bracketed
from rossec.inprocess.doors import CONNECT_TIMEOUT, Stream
from rossec.inprocess.member import now
from rossec.inprocess.plainsocket import PlainStream
from rossec.inprocess.process import Process
from rossec.inprocess.registrations import REFUSED, REGISTRATIONS
from rossec.inprocess.xmlrpc import Params, receive_some
from rossec.net.rpc import CALL_DEADLINE
from rossec.node.questions import PRESENT, QUESTIONS
from rossec.ros.http import HttpClient
from rossec.ros.settings import parse_uri
from rossec.ros.xmlrpc import dump_call, load_response

_MULTICALL: Final = "system.multicall"
_WITH_SERVICE_URI: Final = ("registerService", "unregisterService")
_log = logging.getLogger("rossec.rospy")


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
        """Tell what the master refuses.

        A refused registration waits for a grant, and to rospy it is done: else it would end the
        program, or not, depending on when the master came up.
        """
        registrations = self._process.registrations
        registrations.note(method, params, answer)
        match answer:
            case [code, str(status), _] if code != 1 and status.startswith(REFUSED):
                if registrations.is_rospys_own(method, params):
                    _log.info("rospy's own %s is refused: %s", method, status)
                else:
                    about = status.removeprefix(REFUSED)
                    self._process.reporter.warn(f"the master refuses {method}: {about}")
                if method in REGISTRATIONS:
                    return [1, status, REGISTRATIONS[method]]
            case _:
                pass
        return answer

    # -- other nodes

    def _call_node(self, address: tuple[str, int], method: str, params: Params) -> object:
        name = self._process.member.name  # tools give others
        request = dump_call(method, (name, *params[1:]) if params else params)
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
            self._show(method, stream, address[0])
            return load_response(_exchange(stream, address[0], request))
        finally:
            stream.close()

    def _show(self, method: str, stream: Stream, host: str) -> None:
        """Show the grants for a question; whether they suffice is heard with its answer."""
        right, member = QUESTIONS.get(method), self._process.member
        if right is not None and stream.peer is not None:
            grants = member.access.present(right, stream.peer.name, now())
            _exchange(stream, host, dump_call(PRESENT, (member.name, grants)))

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
        http.feed(receive_some(stream, end))
    return body


def _stock(value: Any) -> Any:
    """The types that stock's clients give a program."""
    if isinstance(value, bytes):
        return xmlrpc.client.Binary(value)
    if isinstance(value, list):
        return [_stock(item) for item in value]
    if isinstance(value, dict):
        return {key: _stock(item) for key, item in value.items()}
    return value
