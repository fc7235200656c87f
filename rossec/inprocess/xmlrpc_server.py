"""This node's own slave API; `rossec.participant.slave_api` authorizes each call.

Calls are parsed by `rossec.ros`, within its limits, never by the standard library's server.
"""

import logging
import socket
import time
from collections.abc import Generator
from contextlib import suppress
from threading import Lock
from typing import Any, Final, TypeVar

from rospy.impl.tcpros_base import get_tcpros_server_address, start_tcpros_server

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError, RevocationsStale
from rossec.channel.opening import REFUSAL, WireProtocol
from rossec.errors import ChannelClosed, ChannelError, HttpRefused, XmlRpcRefused
from rossec.inprocess.connector import Stream
from rossec.inprocess.identity import now
from rossec.inprocess.plain_stream import PlainStream, peek
from rossec.inprocess.process import SecuredProcess
from rossec.net.bounds import UNSHOWN_BODY
from rossec.net.rpc.client import REQUEST_DEADLINE
from rossec.net.rpc.turns import AT_ONCE
from rossec.participant import slave_api
from rossec.participant.remote_names import answer_for
from rossec.participant.slave_api import ports_answer, refusal, topic_offer
from rossec.participant.slave_rights import SLAVE_CALLS, check_slave_call
from rossec.ros import names
from rossec.ros.callserver import CallServer
from rossec.ros.httpread import Oversized
from rossec.ros.names import SIGNED_UPDATES
from rossec.ros.xmlrpc import FAULT_CODE, Call, Fault

_log = logging.getLogger("rossec.rospy")

Params = tuple[Any, ...]
ResultT = TypeVar("ResultT")
_parsing: Final = Lock()
_PAUSE: Final = 0.001  # seconds between two steps, for the other threads


class PresentedGrants:
    """The grants that the peer of one connection has presented."""

    grants: bytes | None = None


class XmlRpcServer:
    """Serves this node's API."""

    def __init__(self, process: SecuredProcess) -> None:
        self._process = process

    def verify_request(self, _server: Any, request: socket.socket, where: Any) -> bool:
        """`ThreadingXMLRPCServer.verify_request`, before a thread is started for a caller."""
        return self._process.connector.admit(request, where[0])

    def finish_request(self, server: Any, request: socket.socket, where: Any) -> None:
        """`ThreadingXMLRPCServer.finish_request`, in a thread of its own: one caller."""
        if self._process.plain and peek(request) == b"POST":
            try:
                self._answer_plain(request, where[0])
            finally:
                self._process.connector.release(request)
            return
        stream = self._process.connector.respond(request, WireProtocol.HTTP)
        caller = f"the caller from {where[0]}"
        try:
            peer = stream.do_handshake()
            caller = shown(peer.name)
            self._process.connections.accept(stream, peer, lambda _: stream.shutdown())
            if self._is_master(peer):
                stream.raise_unit_limit()
            self._serve(server, stream, peer)
        except ChannelClosed:
            pass
        except (HintedError, TimeoutError) as error:
            self._process.reporter.warn(f"refused {caller}", error)
        finally:
            self._process.connections.forget(stream)
            stream.close()

    def _serve(self, server: Any, stream: Stream, peer: Identity) -> None:
        """Serve one connection: the master's without a deadline, another node's with one."""
        calls, presented = CallServer(), PresentedGrants()
        end = None if self._is_master(peer) else time.monotonic() + slave_api.DEADLINE
        try:
            while not calls.closing:
                request = _next_request(calls, stream, end)
                stream.settimeout(REQUEST_DEADLINE)
                stream.sendall(self._answer(server, calls, request, peer, presented))
        except HttpRefused as error:
            with suppress(ChannelError, OSError):
                stream.sendall(calls.refuse(error.status))

    def _answer_plain(self, request: socket.socket, address: str) -> None:
        """A plain caller may request a topic that `allow_plain` names, and nothing else."""
        stream, calls = PlainStream(request), CallServer(compact=False)
        with suppress(HintedError, OSError):
            call = calls.load(_next_request(calls, stream, time.monotonic() + REQUEST_DEADLINE))
            match call.method, call.params:
                case "requestTopic", (_, str() as topic, list() as protocols) if (
                    self._process.allows_plain(topic, address)
                ):
                    start_tcpros_server()
                    answer = topic_offer(protocols, *get_tcpros_server_address())
                case _:
                    answer = [-1, REFUSAL, 0]
            stream.sendall(calls.respond(answer))

    def _answer(
        self,
        server: Any,
        calls: CallServer,
        request: bytes | Oversized,
        peer: Identity,
        presented: PresentedGrants,
    ) -> bytes:
        try:
            call = _load(calls, request, master=self._is_master(peer))
            return calls.respond(self._value(server, call.method, call.params, peer, presented))
        except Fault as fault:  # too long
            return calls.respond(fault)
        except XmlRpcRefused as error:
            return calls.respond(Fault(FAULT_CODE, str(error)))

    def _value(
        self, server: Any, method: str, params: Params, peer: Identity, presented: PresentedGrants
    ) -> object:
        try:
            self._check(method, peer)
            match method, params:
                case names.PRESENT_GRANTS, (_, bytes() as grants):
                    presented.grants = grants
                    return [1, "", 0]
                case _:
                    pass
            authorized = self._is_authorized(method, peer, presented)
            master = self._process.local_identity.master
            refused = refusal(method, params, peer, authorized=authorized, master=master)
            if refused is not None:
                self._process.reporter.warn(f"refused {shown(peer.name)}: {method}: {refused[1]}")
                return refused
            return self._run(server, method, params, peer)
        except HintedError as error:
            self._process.reporter.warn(f"refused {shown(peer.name)}: {method}", error)
            return [-1, f"rossec: {error}", 0]
        except Exception:  # noqa: BLE001 - no internals to a peer
            _log.exception("a call failed")
            return Fault(FAULT_CODE, "rossec: internal error")

    def _check(self, method: str, peer: Identity) -> None:
        """Checked at every call: a peer, also the master, may be revoked while connected."""
        try:
            self._process.local_identity.access.check_peer(peer, now())
        except RevocationsStale:
            if method not in SIGNED_UPDATES:  # one of them ends it
                raise

    def _is_master(self, peer: Identity) -> bool:
        return self._process.local_identity.access.is_master(peer)

    def _is_authorized(self, method: str, peer: Identity, presented: PresentedGrants) -> bool:
        """Whether grants that `peer` has presented on this connection authorize it for the call.

        Raises:
            HintedError: those it has presented do not.
        """
        if presented.grants is None or method not in SLAVE_CALLS or self._is_master(peer):
            return False
        local_identity = self._process.local_identity
        check_slave_call(
            method, peer, local_identity.name, presented.grants, local_identity.access, now()
        )
        return True

    def _run(self, server: Any, method: str, params: Params, peer: Identity) -> object:
        if method in SIGNED_UPDATES:
            self._process.membership.take_push(method, params[1:], peer)
            return [1, "", 0]
        if method == "requestTopic":
            start_tcpros_server()
            return topic_offer(params[2], *get_tcpros_server_address())
        if method == names.PORTS:
            start_tcpros_server()
            return ports_answer(get_tcpros_server_address()[1])
        if method == "publisherUpdate":
            self._process.registrations.set_publishers(params[1], params[2])
        match server._dispatch(method, params):  # noqa: SLF001 - stock's handler
            case [code, status, value]:
                return [code, status, answer_for(peer, method, value)]
            case answer:
                return list(answer)


def _load(calls: CallServer, request: bytes | Oversized, *, master: bool) -> Call:
    """The call in a request: of one other peer at a time, and in steps.

    Threads that parse share the interpreter with those that publish, each with one share: so all
    callers together have one. The master does not wait behind them.
    """
    if master or isinstance(request, Oversized) or len(request) <= AT_ONCE:
        return calls.load(request)
    return in_steps(calls.load_steps(request, UNSHOWN_BODY), _parsing)


def in_steps(steps: Generator[None, None, ResultT], turn: Lock) -> ResultT:
    """The result of parsing, with pauses; one at a time of those with the same `turn`."""
    with turn:
        while True:
            try:
                next(steps)
            except StopIteration as end:
                result: ResultT = end.value
                return result
            time.sleep(_PAUSE)


def _next_request(
    calls: CallServer, stream: Stream | PlainStream, end: float | None
) -> bytes | Oversized:
    request = calls.take()
    while request is None:
        waiting = end
        if calls.pending:
            begun = time.monotonic() + REQUEST_DEADLINE
            waiting = begun if end is None else min(begun, end)
        request = calls.take(receive_some(stream, waiting))
    return request


def receive_some(stream: Stream | PlainStream, end: float | None) -> bytes:
    """The unit that arrives next, until `end` at the latest; of a plain stream some bytes.

    Raises:
        ChannelClosed, TimeoutError: nothing arrives.
    """
    stream.settimeout(None if end is None else max(0.001, end - time.monotonic()))
    data = stream.receive_unit()
    if not data:
        raise ChannelClosed("the peer closed the connection")
    return bytes(data)
