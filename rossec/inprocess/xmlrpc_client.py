"""The calls of rospy: to the master, over the background loop's session, and to nodes.

Calls and answers are parsed by `rossec.ros`, within its limits, never by the standard library.
Errors are those rospy handles: OSError. A slave call that needs a right is preceded by the grants
that prove it (`rossec.participant.slave_rights`). Proxies that a program makes itself, as rostest
does, are secured if they lead to the master, or to a node that the master has named.
"""

import errno
import logging
import socket
import time
import xmlrpc.client
from threading import Lock
from typing import Any, Final

import rosgraph

from ca.certificates import Identity
from ca.domains.aliases import origin_of
from ca.errors import HintedError
from grants.basics import is_dispensable
from grants.missing_rights import missing_right, refusal
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import ConfigurationError, PlainPeer
from rossec.inprocess.addresses import bracketed
from rossec.inprocess.connector import CONNECT_TIMEOUT, Stream
from rossec.inprocess.identity import now
from rossec.inprocess.plain_stream import PlainStream
from rossec.inprocess.process import SecuredProcess
from rossec.inprocess.registrations import REFUSED, REGISTRATIONS
from rossec.inprocess.xmlrpc_server import Params, in_steps, receive_some
from rossec.net.rpc.client import CALL_DEADLINE
from rossec.net.rpc.turns import AT_ONCE
from rossec.participant.caller_names import (
    SEARCH,
    not_found,
    resolve_params,
    search_places,
    search_result,
    searched_key,
)
from rossec.participant.remote_names import answer_here, offer_refusal
from rossec.participant.silent_answers import nothing_shown, shows_nothing, unheard_refusal
from rossec.participant.slave_rights import SLAVE_CALLS
from rossec.participant.wire_names import wire_name
from rossec.ros.callclient import CallClient, value_in, value_steps
from rossec.ros.names import PRESENT_GRANTS
from rossec.ros.settings import is_door, parse_uri
from rossec.ros.xmlrpc import Encoded

REQUEST: Final = "_ServerProxy__request"  # every call of the library's proxies goes through it
_MULTICALL: Final = "system.multicall"
_WITH_SERVICE_URI: Final = ("registerService", "unregisterService")
_parsing: Final = Lock()
_log = logging.getLogger("rossec.rospy")


class XmlRpcClient:
    """The calling side of one process."""

    def __init__(self, process: SecuredProcess) -> None:
        self._process = process
        self._stock_request: Any = getattr(xmlrpc.client.ServerProxy, REQUEST)

    def proxy_class(self) -> type[xmlrpc.client.ServerProxy]:
        """Replaces `xmlrpc.client.ServerProxy` in rospy; thread-safe."""
        client = self

        class SecureProxy(xmlrpc.client.ServerProxy):
            """Calls over the secure channel."""

            def __init__(self, uri: str, *_: Any, **__: Any) -> None:
                super().__init__(uri)
                self._rossec_uri = uri

            def _ServerProxy__request(self, method: str, params: Params) -> Any:  # noqa: N802 - the base's name
                return client.call(self._rossec_uri, method, params)

        return SecureProxy

    def request(self, proxy: Any, method: str, params: Params) -> Any:
        """`ServerProxy.__request`: a call through a proxy that the program made itself."""
        uri = _uri_of(proxy)
        address = _address(uri)
        if address is not None and self._is_secured(address):
            return self.call(uri, method, params)
        return self._stock_request(proxy, method, params)

    def _is_secured(self, address: tuple[str, int]) -> bool:
        """Whether the master is there, or a node that it has named; others are not secured."""
        process = self._process
        if not process.has_begun:
            return address == _address(rosgraph.get_master_uri() or "")
        own, known = process.own_addresses.is_own, process.registrations.is_node
        return address == process.background_loop.address or own(address) or known(address)

    def call(self, uri: str, method: str, params: Params) -> object:
        """The value a node answers.

        Raises:
            Fault: it answered with a fault.
            OSError: it cannot be reached, or is not authorized.
        """
        address = parse_uri(uri)
        if address == self._process.background_loop.address:
            return self._call_master(method, params)
        try:
            return _stock_types(self._call_node(uri, method, params))
        except PlainPeer as error:  # rospy tries again after this one
            raise ConnectionRefusedError(
                errno.ECONNREFUSED, self._report_refusal(uri, error)
            ) from error
        except HintedError as error:
            raise ConnectionAbortedError(
                errno.ECONNABORTED, self._report_refusal(uri, error)
            ) from error

    def _report_refusal(self, uri: str, error: HintedError) -> str:
        self._process.reporter.warn(f"cannot call {uri}", error)
        return f"rossec: {error}"

    # -- the master

    def _call_master(self, method: str, params: Params) -> object:
        if method == _MULTICALL:
            return self._multicall(params)
        named, key = self._with_own_name(method, params), searched_key(method, params)
        refused = offer_refusal(method, named)
        if refused is not None:  # rospy.set_param ignores the answer
            self._process.reporter.warn(f"{method}: {str(refused[1]).removeprefix(REFUSED)}")
            return refused
        if key is not None and named[0] != params[0]:
            return self._search(str(params[0]), key)
        return self._record_answer(
            method, named, _stock_types(self._process.background_loop.call(method, named))
        )

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
        """Search from the namespace of `caller_id`; the master searches from the node's."""
        name = self._process.local_identity.name
        for place, found in search_places(caller_id, key):
            answer = search_result(
                _stock_types(self._process.background_loop.call(SEARCH, (name, place))), found
            )
            if answer is not None:
                return answer
        return not_found(key)

    def _with_own_name(self, method: str, params: Params) -> Params:
        """Tools and early calls give other names than the node's certified one."""
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
        """Record the answer, and log a refusal.

        A refused registration is repeated with a new grant, and rospy gets a success: else it would
        end the program, or not, depending on when the master started.
        """
        registrations = self._process.registrations
        registrations.record(method, params, answer)
        match answer:
            case [code, str(status), _] if code != 1 and status.startswith(REFUSED):
                self._report_missing(method, status)
                if method in REGISTRATIONS:
                    return [1, status, REGISTRATIONS[method]]
            case _ if (reason := unheard_refusal(method, params, answer)) is not None:
                self._process.reporter.warn(f"the master refuses {method}: {reason}")
            case _ if shows_nothing(method, answer) and not self._may_see_all():
                name = self._process.local_identity.identity.name
                self._process.reporter.warn(f"{method}: {nothing_shown(name)}")
            case _:
                pass
        return answer

    def _may_see_all(self) -> bool:
        identity = self._process.local_identity
        return identity.access.holds(Right.GRAPH, identity.name, now())

    def _report_missing(self, method: str, status: str) -> None:
        missing = missing_right(status)
        if missing is None:
            detail = status.removeprefix(REFUSED)
            self._process.reporter.warn(f"the master refuses {method}: {detail}")
        elif is_dispensable(missing.right, missing.own):
            _log.info("rospy's own %s is refused: %s", method, status)
        else:
            self._process.reporter.warn(refusal(missing.node, [(missing.right, missing.in_rule)]))

    # -- other nodes

    def _call_node(self, uri: str, method: str, params: Params) -> object:
        local_identity, address = self._process.local_identity, parse_uri(uri)
        sock = socket.create_connection(address, CONNECT_TIMEOUT)
        try:
            stream = self._process.connector.initiate(sock, WireProtocol.HTTP, address)
        except PlainPeer:
            if not self._process.plain or method != "requestTopic" or is_door(uri):
                raise
            return self._call_plain(address, _named(method, params, local_identity.name), params)
        try:
            peer = stream.do_handshake()
            local_identity.access.check_peer(peer, now())
            calls = CallClient(_host(address))
            self._present_grants(method, stream, calls)
            named = _named(method, params, local_identity.name_for(peer), peer)
            return self._here(peer, method, _exchange(stream, calls, method, named))
        finally:
            stream.close()

    def _here(self, peer: Identity, method: str, answer: object) -> object:
        """An answer in local names."""
        match answer:
            case [1, status, value]:
                domain = self._process.local_identity.identity.domain
                return [1, status, answer_here(peer, domain, method, value)]
            case _:
                return answer

    def _present_grants(self, method: str, stream: Stream, calls: CallClient) -> None:
        """Present the grants that a slave call needs; its answer tells whether they suffice."""
        right, local_identity = SLAVE_CALLS.get(method), self._process.local_identity
        if right is not None and stream.peer is not None:
            grants = local_identity.access.present(right, stream.peer.name, now())
            _exchange(stream, calls, PRESENT_GRANTS, (local_identity.name, grants))

    def _call_plain(self, address: tuple[str, int], named: Params, params: Params) -> object:
        sock = socket.create_connection(address, CONNECT_TIMEOUT)
        with sock:
            if not self._process.allows_plain(str(params[1]), sock.getpeername()[0]):
                raise PlainPeer("the peer is a plain ROS node", "secure it, or see allow_plain")
            calls = CallClient(_host(address), compact=False)
            return _exchange(PlainStream(sock), calls, "requestTopic", named)


def _named(method: str, params: Params, caller: str, peer: Identity | None = None) -> Params:
    """The call of a peer (None: a plain one): under the node's name, by the topic's on the wire."""
    match method, params:
        case _, ():
            return ()
        case "requestTopic", (_, str() as topic, *rest):
            named = origin_of(topic) if peer is None else wire_name(peer, topic)
            return (caller, named, *rest)
        case _:
            return (caller, *params[1:])


def _uri_of(proxy: Any) -> str:
    """The URI of a proxy of the standard library; empty: not plain HTTP."""
    plain = type(proxy("transport")) is xmlrpc.client.Transport
    return f"http://{proxy._ServerProxy__host}/" if plain else ""  # noqa: SLF001 - the library has no accessor


def _address(uri: str) -> tuple[str, int] | None:
    """Host and port of an HTTP URI; None: invalid."""
    try:
        return parse_uri(uri)
    except ConfigurationError:
        return None


def _host(address: tuple[str, int]) -> str:
    host = address[0]
    return f"[{host}]" if ":" in host else host


def _exchange(
    stream: Stream | PlainStream, calls: CallClient, method: str, params: Params
) -> object:
    """The value that one call is answered with; a long answer is parsed in steps.

    A hostile server answers with megabytes: parsing them shares the interpreter with the threads
    that publish. All such answers together have one share.
    """
    request = calls.request(method, params)
    end = time.monotonic() + CALL_DEADLINE
    stream.settimeout(CALL_DEADLINE)
    stream.sendall(request)
    while (answer := _taken(calls, receive_some(stream, end))) is None:
        pass
    if isinstance(answer, Encoded) and len(answer.body) > AT_ONCE:
        return in_steps(value_steps(answer), _parsing)
    return value_in(answer)


def _taken(calls: CallClient, data: bytes) -> object:
    """As `CallClient.take`."""
    return calls.take(data) if len(data) <= AT_ONCE else in_steps(calls.take_steps(data), _parsing)


def _stock_types(value: Any) -> Any:
    """`value` with the types that stock clients return."""
    if isinstance(value, bytes):
        return xmlrpc.client.Binary(value)
    if isinstance(value, list):
        return [_stock_types(item) for item in value]
    if isinstance(value, dict):
        return {key: _stock_types(item) for key, item in value.items()}
    return value
