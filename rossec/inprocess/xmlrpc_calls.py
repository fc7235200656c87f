"""XML-RPC of this process: its own slave API, and rospy's calls to the master and to nodes.

Calls and answers are parsed by `rossec.ros`, within its limits, never by the standard library.
`rossec.participant.slave_api` authorizes each call of a peer. Errors are those rospy handles: OSError.
"""

import errno
import logging
import socket
import time
import xmlrpc
import xmlrpc.client
from collections.abc import Generator
from contextlib import suppress
from threading import Lock
from typing import Any, Final, TypeVar

import rosgraph
from rospy.impl.tcpros_base import get_tcpros_server_address, start_tcpros_server

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from ca.names import origin_of, shown
from grants.model import Right
from grants.request import is_dispensable, missing_right
from grants.request import refusal as request_refusal
from rossec import errors
from rossec.channel.opening import REFUSAL, WireProtocol
from rossec.inprocess.identity import CONNECT_TIMEOUT, PlainSocketStream, Stream, now, peek
from rossec.inprocess.process import REGISTRATIONS, SecuredProcess
from rossec.inprocess.sockets import bracketed
from rossec.net.limits import UNSHOWN_BODY
from rossec.net.rpc import AT_ONCE, CALL_DEADLINE, REQUEST_DEADLINE
from rossec.participant import access, handshakes, slave_api
from rossec.participant.registrations import (
    REFUSED,
    SEARCH,
    not_found,
    nothing_shown,
    resolve_params,
    search_places,
    search_result,
    searched_key,
    shows_nothing,
    unheard_refusal,
)
from rossec.participant.slave_api import SLAVE_CALLS, check_slave_call, ports_answer, refusal, topic_offer
from rossec.ros import http, names
from rossec.ros.calls import CallClient, CallServer, value_in, value_steps
from rossec.ros.names import PRESENT_GRANTS, SIGNED_UPDATES, is_forwarded_port, parse_uri
from rossec.ros.xmlrpc import FAULT_CODE, Call, Encoded, Fault

_log = logging.getLogger("rossec.rospy")
Params = tuple[Any, ...]
ResultT = TypeVar("ResultT")
_parsing: Final = Lock()
_PAUSE: Final = 0.001  # seconds between two steps, for the other threads
REQUEST: Final = "_ServerProxy__request"  # every call of the library's proxies goes through it
_MULTICALL: Final = "system.multicall"
_WITH_SERVICE_URI: Final = ("registerService", "unregisterService")


class CallGrants:
    grants: bytes | None = None


class XmlRpcServer:
    def __init__(self, process: SecuredProcess) -> None:
        self._process = process

    def verify_request(self, _server: Any, request: socket.socket, where: Any) -> bool:
        return self._process.connector.admit(request, where[0])

    def finish_request(self, server: Any, request: socket.socket, where: Any) -> None:
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
            self._process.connections.accept(stream, peer)
            # Only the master may send long calls: of others nothing more is buffered.
            if self._is_master(peer):
                stream.raise_unit_limit()
            self._serve(server, stream, peer)
        except errors.ChannelClosed:
            pass
        except (HintedError, TimeoutError) as error:
            self._process.reporter.warn(f"refused {caller}", error)
        finally:
            self._process.connections.forget(stream)
            stream.close()

    def _serve(self, server: Any, stream: Stream, peer: Identity) -> None:
        calls, presented = CallServer(), CallGrants()
        end = None if self._is_master(peer) else time.monotonic() + slave_api.DEADLINE
        try:
            while not calls.closing:
                request = _next_request(calls, stream, end)
                stream.settimeout(REQUEST_DEADLINE)
                stream.sendall(self._answer(server, calls, request, peer, presented))
        except errors.HttpRefused as error:
            with suppress(errors.ChannelError, OSError):
                stream.sendall(calls.refuse(error.status))

    def _answer_plain(self, request: socket.socket, address: str) -> None:
        stream, calls = PlainSocketStream(request), CallServer(compact=False)
        with suppress(HintedError, OSError):
            call = calls.load(_next_request(calls, stream, time.monotonic() + REQUEST_DEADLINE))
            match call.method, call.params:
                case "requestTopic", (_, str() as topic, list() as protocols) if self._process.allows_plain(
                    topic, address
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
        request: bytes | http.Oversized,
        peer: Identity,
        presented: CallGrants,
    ) -> bytes:
        try:
            call = _load(calls, request, master=self._is_master(peer))
            return calls.respond(self._value(server, call.method, call.params, peer, presented))
        except Fault as fault:  # too long
            return calls.respond(fault)
        except errors.XmlRpcRefused as error:
            return calls.respond(Fault(FAULT_CODE, str(error)))

    def _value(
        self, server: Any, method: str, params: Params, peer: Identity, presented: CallGrants
    ) -> object:
        try:
            try:
                self._process.local_identity.access.check_peer(peer, now())
            except RevocationsStale:
                if method not in SIGNED_UPDATES:  # one of them ends it
                    raise
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

    def _is_master(self, peer: Identity) -> bool:
        return self._process.local_identity.access.is_master(peer)

    def _is_authorized(self, method: str, peer: Identity, presented: CallGrants) -> bool:
        if presented.grants is None or method not in SLAVE_CALLS or self._is_master(peer):
            return False
        local_identity = self._process.local_identity
        check_slave_call(method, peer, local_identity.name, presented.grants, local_identity.access, now())
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
                return [code, status, handshakes.answer_for(peer, method, value)]
            case answer:
                return list(answer)


def _load(calls: CallServer, request: bytes | http.Oversized, *, master: bool) -> Call:
    # Threads that parse share the interpreter with those that publish, each with one share: so all callers
    # together have one. The master does not wait behind them.
    if master or isinstance(request, http.Oversized) or len(request) <= AT_ONCE:
        return calls.load(request)
    return in_steps(calls.load_steps(request, UNSHOWN_BODY), _parsing)


def in_steps(steps: Generator[None, None, ResultT], turn: Lock) -> ResultT:
    with turn:
        while True:
            try:
                next(steps)
            except StopIteration as end:
                result: ResultT = end.value
                return result
            time.sleep(_PAUSE)


def _next_request(
    calls: CallServer, stream: Stream | PlainSocketStream, end: float | None
) -> bytes | http.Oversized:
    request = calls.take()
    while request is None:
        waiting = end
        if calls.pending:
            begun = time.monotonic() + REQUEST_DEADLINE
            waiting = begun if end is None else min(begun, end)
        request = calls.take(receive_some(stream, waiting))
    return request


def receive_some(stream: Stream | PlainSocketStream, end: float | None) -> bytes:
    stream.settimeout(None if end is None else max(0.001, end - time.monotonic()))
    data = stream.receive_unit()
    if not data:
        raise errors.ChannelClosed("the peer closed the connection")
    return bytes(data)


class XmlRpcClient:
    def __init__(self, process: SecuredProcess) -> None:
        self._process = process
        self._stock_request: Any = getattr(xmlrpc.client.ServerProxy, REQUEST)

    def proxy_class(self) -> type[xmlrpc.client.ServerProxy]:
        client = self

        class SecureProxy(xmlrpc.client.ServerProxy):
            def __init__(self, uri: str, *_: Any, **__: Any) -> None:
                super().__init__(uri)
                self._rossec_uri = uri

            def _ServerProxy__request(self, method: str, params: Params) -> Any:  # noqa: N802 - the base's name
                return client.call(self._rossec_uri, method, params)

        return SecureProxy

    def request(self, proxy: Any, method: str, params: Params) -> Any:
        # The URI of a proxy of the standard library; empty: not plain HTTP.
        plain = type(proxy("transport")) is xmlrpc.client.Transport
        uri = f"http://{proxy._ServerProxy__host}/" if plain else ""  # noqa: SLF001 - the library has no accessor
        address, process = _address(uri), self._process
        # Proxies that a program makes itself, as rostest does.
        # Secured: what leads to the master, or to a node that it has named; others are the program's affair.
        if address is None:
            secured = False
        elif not process.has_begun:
            secured = address == _address(rosgraph.get_master_uri() or "")
        else:
            own, known = process.own_addresses.is_own, process.registrations.is_node
            secured = address == process.background_loop.address or own(address) or known(address)
        return self.call(uri, method, params) if secured else self._stock_request(proxy, method, params)

    def call(self, uri: str, method: str, params: Params) -> object:
        address = parse_uri(uri)
        if address == self._process.background_loop.address:
            if method == _MULTICALL:
                return self._multicall(params)
            named, key = self._with_own_name(method, params), searched_key(method, params)
            refused = handshakes.offer_refusal(method, named)
            if refused is not None:  # rospy.set_param ignores the answer
                self._process.reporter.warn(f"{method}: {str(refused[1]).removeprefix(REFUSED)}")
                return refused
            if key is not None and named[0] != params[0]:
                return self._search(str(params[0]), key)
            return self._record_answer(
                method, named, _stock_types(self._process.background_loop.call(method, named))
            )
        try:
            return _stock_types(self._call_node(uri, method, params))
        except errors.PlainPeer as error:  # rospy tries again after this one
            raise ConnectionRefusedError(errno.ECONNREFUSED, self._report_refusal(uri, error)) from error
        except HintedError as error:
            raise ConnectionAbortedError(errno.ECONNABORTED, self._report_refusal(uri, error)) from error

    def _report_refusal(self, uri: str, error: HintedError) -> str:
        self._process.reporter.warn(f"cannot call {uri}", error)
        return f"rossec: {error}"

    # -- the master

    def _multicall(self, params: Params) -> object:
        calls = [
            {**call, "params": list(self._with_own_name(call["methodName"], tuple(call["params"])))}
            for call in params[0]
        ]
        answer = _stock_types(self._process.background_loop.call(_MULTICALL, (calls,)))
        for call in calls:
            self._process.registrations.record(call["methodName"], call["params"], [1, "", 0])
        return answer

    def _search(self, caller_id: str, key: str) -> object:
        name = self._process.local_identity.name
        for place, found in search_places(caller_id, key):
            answer = search_result(
                _stock_types(self._process.background_loop.call(SEARCH, (name, place))), found
            )
            if answer is not None:
                return answer
        return not_found(key)

    def _with_own_name(self, method: str, params: Params) -> Params:
        name = self._process.local_identity.name
        if not params or not isinstance(params[0], str):
            return params  # the master answers what is wrong
        if params[0] != name:
            params = resolve_params(method, params, params[0])
        match params[1:]:
            case (service, str(uri), *more) if method in _WITH_SERVICE_URI:
                return (name, service, bracketed(uri), *more)
            case rest:
                return (name, *rest)

    def _record_answer(self, method: str, params: Params, answer: object) -> object:
        # A refused registration is repeated with a new grant, and rospy gets a success: else it would end the
        # program, or not, depending on when the master started.
        registrations = self._process.registrations
        registrations.record(method, params, answer)
        match answer:
            case [code, str(status), _] if code != 1 and status.startswith(REFUSED):
                missing = missing_right(status)
                if missing is None:
                    detail = status.removeprefix(REFUSED)
                    self._process.reporter.warn(f"the master refuses {method}: {detail}")
                elif is_dispensable(missing.right, missing.own):
                    _log.info("rospy's own %s is refused: %s", method, status)
                else:
                    self._process.reporter.warn(
                        request_refusal(missing.node, [(missing.right, missing.in_rule)])
                    )
                if method in REGISTRATIONS:
                    return [1, status, REGISTRATIONS[method]]
            case _ if (reason := unheard_refusal(method, params, answer)) is not None:
                self._process.reporter.warn(f"the master refuses {method}: {reason}")
            case _ if shows_nothing(method, answer):
                own = self._process.local_identity
                if not own.access.holds(Right.GRAPH, own.name, now()):
                    self._process.reporter.warn(f"{method}: {nothing_shown(own.identity.name)}")
            case _:
                pass
        return answer

    # -- other nodes

    def _call_node(self, uri: str, method: str, params: Params) -> object:
        local_identity, address = self._process.local_identity, parse_uri(uri)
        sock = socket.create_connection(address, CONNECT_TIMEOUT)
        try:
            stream = self._process.connector.initiate(sock, WireProtocol.HTTP, address)
        except errors.PlainPeer:
            if not self._process.plain or method != "requestTopic" or is_forwarded_port(uri):
                raise
            return self._call_plain(address, _named(method, params, local_identity.name), params)
        try:
            peer = stream.do_handshake()
            local_identity.access.check_peer(peer, now())
            calls = CallClient(_host(address))
            right = SLAVE_CALLS.get(method)
            if right is not None:  # the grants that prove it come first
                grants = local_identity.access.present(right, peer.name, now())
                _exchange(stream, calls, PRESENT_GRANTS, (local_identity.name, grants))
            named = _named(method, params, local_identity.name_for(peer), peer)
            answer = _exchange(stream, calls, method, named)
            match answer:
                case [1, status, value]:
                    domain = local_identity.identity.domain
                    return [1, status, handshakes.answer_here(peer, domain, method, value)]
                case _:
                    return answer
        finally:
            stream.close()

    def _call_plain(self, address: tuple[str, int], named: Params, params: Params) -> object:
        sock = socket.create_connection(address, CONNECT_TIMEOUT)
        with sock:
            if not self._process.allows_plain(str(params[1]), sock.getpeername()[0]):
                raise errors.PlainPeer("the peer is a plain ROS node", "secure it, or see allow_plain")
            calls = CallClient(_host(address), compact=False)
            return _exchange(PlainSocketStream(sock), calls, "requestTopic", named)


def _named(method: str, params: Params, caller: str, peer: Identity | None = None) -> Params:
    match method, params:
        case _, ():
            return ()
        case "requestTopic", (_, str() as topic, *rest):
            named = origin_of(topic) if peer is None else access.wire_name(peer, topic)
            return (caller, named, *rest)
        case _:
            return (caller, *params[1:])


def _address(uri: str) -> tuple[str, int] | None:
    try:
        return parse_uri(uri)
    except errors.ConfigurationError:
        return None


def _host(address: tuple[str, int]) -> str:
    host = address[0]
    return f"[{host}]" if ":" in host else host


def _exchange(stream: Stream | PlainSocketStream, calls: CallClient, method: str, params: Params) -> object:
    # A hostile server answers with megabytes: parsing them shares the interpreter with the threads that
    # publish. All such answers together have one share.
    request = calls.request(method, params)
    end = time.monotonic() + CALL_DEADLINE
    stream.settimeout(CALL_DEADLINE)
    stream.sendall(request)
    answer: object = None
    while answer is None:
        data = receive_some(stream, end)
        answer = calls.take(data) if len(data) <= AT_ONCE else in_steps(calls.take_steps(data), _parsing)
    if isinstance(answer, Encoded) and len(answer.body) > AT_ONCE:
        return in_steps(value_steps(answer), _parsing)
    return value_in(answer)


def _stock_types(value: Any) -> Any:
    if isinstance(value, bytes):
        return xmlrpc.client.Binary(value)
    if isinstance(value, list):
        return [_stock_types(item) for item in value]
    if isinstance(value, dict):
        return {key: _stock_types(item) for key, item in value.items()}
    return value
