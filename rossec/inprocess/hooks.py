"""The hooks: exactly what is replaced in rospy and rosgraph.

A hook names a module, an attribute path and the parameters its stock function must have. `check` repeats
the check when the node starts.
"""

import inspect
import socket
import sys
import threading
import xmlrpc
import xmlrpc.client
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any, Final, NamedTuple

import rosgraph
import rosgraph.impl.graph
import rosgraph.masterapi
import rosgraph.network
import rosgraph.xmlrpc
import rospy
import rospy.core
import rospy.impl.init
import rospy.impl.registration
import rospy.impl.tcpros_base
import rospy.impl.tcpros_pubsub
import rospy.impl.tcpros_service
import rospy.topics
from rospy.impl.validators import ParameterInvalid

from rossec.errors import ConfigurationError
from rossec.inprocess.connections import Connections, ServiceProbe, SubscriptionLoop
from rossec.inprocess.process import SecuredProcess
from rossec.inprocess.publishing import publish, queue_for, write_data
from rossec.inprocess.sockets import RosSocket, bracketed, parse_rosrpc
from rossec.inprocess.xmlrpc_calls import REQUEST, XmlRpcClient, XmlRpcServer
from rossec.ros.names import parse_uri

VERSIONS: Final = ("1.14", "1.15", "1.16", "1.17")
_LATE: Final = "call rossec.secure() right after importing rospy, before anything else of it"
_CALLER: Final = ("self", "request", "client_address")


class ModuleProxy:
    """A module in which some names are replaced, for rospy."""

    def __init__(self, module: ModuleType, **replaced: object) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


class Hook(NamedTuple):
    owner: Any
    name: str
    new: object
    parameters: tuple[str, ...] | None = None


def rospy_version() -> str:
    try:
        found = version("rospy")
    except PackageNotFoundError:
        found = ""
    if not found.startswith(tuple(f"{known}." for known in VERSIONS)):
        raise ConfigurationError(
            f"rospy {found or 'of unknown version'} is not supported",
            f"rossec supports {VERSIONS[0]} to {VERSIONS[-1]}; for others use `rossec run`",
        )
    return found


def check_in_time() -> None:
    """Check that the program has opened no connection yet: it would stay plain."""
    base, core = rospy.impl.tcpros_base, rospy.core
    if core.is_initialized() or rospy.client._init_node_args:  # noqa: SLF001 - rospy has no function for it
        raise ConfigurationError("rossec.secure() comes after rospy.init_node()", _LATE)
    if base._tcpros_server is not None or core._xmlrpc_cache:  # noqa: SLF001 - rospy's
        raise ConfigurationError("rospy has connected already, without rossec", _LATE)
    topics = rospy.impl.registration.get_topic_manager()
    if topics.get_topics():
        raise ConfigurationError("a topic was created before rossec.secure()", _LATE)


def hooks(process: SecuredProcess, start_node: Callable[..., Any]) -> list[Hook]:
    base, pubsub, service = rospy.impl.tcpros_base, rospy.impl.tcpros_pubsub, rospy.impl.tcpros_service
    connections, client, server = Connections(process), XmlRpcClient(process), XmlRpcServer(process)

    def make(family: int = socket.AF_INET, kind: int = socket.SOCK_STREAM) -> RosSocket:
        return RosSocket(process, socket.socket(family, kind))

    def accepted(tcpros: Any, sock: RosSocket, where: Any) -> None:
        arguments = (tcpros, sock, where)
        try:
            threading.Thread(target=connections.serve, args=arguments, daemon=True).start()
        except RuntimeError:  # out of threads: only this caller is dropped
            sock.close()

    stock_wait = service.wait_for_service

    def wait_for_service(service: Any, timeout: Any = None) -> None:
        process.require_begun()  # rospy's loop would catch the error and never end
        stock_wait(service, timeout)

    def parse_service_uri(uri: str) -> tuple[str, int]:
        try:
            return parse_rosrpc(uri)
        except ConfigurationError as error:
            raise ParameterInvalid(str(error)) from error

    def set_uri(node: Any, uri: str) -> None:
        node.uri = bracketed(uri)
        host, port = parse_uri(node.uri)
        process.listens(port, host)

    proxy, proxies = client.proxy_class(), xmlrpc.client.ServerProxy
    write_header, read_header = map(_as_function, (connections.write_header, connections.read_header))
    verify_request, finish_request = map(_as_function, (server.verify_request, server.finish_request))
    publisher = rospy.topics._PublisherImpl  # noqa: SLF001 - rospy's
    subscribes = ("conn", "dest_addr", "dest_port", "pub_uri", "receive_cb", "resolved_topic_name")
    starts = ("environ", "resolved_name", "master_uri", "port", "tcpros_port")
    api, transport = rosgraph.xmlrpc.ThreadingXMLRPCServer, base.TCPROSTransport
    return [
        # connections of topics and services
        Hook(base, "socket", ModuleProxy(socket, socket=make)),
        Hook(service, "socket", ModuleProxy(socket, socket=_probes(process))),
        Hook(base.TCPROSServer, "_tcp_server_callback", accepted, ("self", "sock", "client_addr")),
        Hook(transport, "write_header", write_header, ("self",)),
        Hook(transport, "read_header", read_header, ("self",)),
        Hook(transport, "write_data", write_data, ("self", "data")),
        # topics
        Hook(pubsub, "robust_connect_subscriber", SubscriptionLoop(process).run, subscribes),
        Hook(publisher, "publish", publish, ("self", "message", "connection_override")),
        Hook(rospy.topics, "QueuedConnection", queue_for, ("self", "connection", "queue_size")),
        Hook(pubsub, "QueuedConnection", queue_for, ("self", "connection", "queue_size")),
        # XML-RPC calls from here
        Hook(rospy.core, "xmlrpcclient", ModuleProxy(xmlrpc.client, ServerProxy=proxy)),
        Hook(rospy.core, "_LockedServerProxy", proxy, ("self", "args", "kwargs")),
        Hook(pubsub, "ServerProxy", proxy),
        Hook(rosgraph.masterapi, "ServerProxy", proxy),
        Hook(rosgraph.impl.graph, "ServerProxy", proxy),
        Hook(proxies, REQUEST, _as_function(client.request), ("self", "methodname", "params")),
        # waiting for services
        Hook(service, "wait_for_service", wait_for_service, ("service", "timeout")),
        Hook(rospy, "wait_for_service", wait_for_service, ("service", "timeout")),
        Hook(rospy.core, "parse_rosrpc_uri", parse_service_uri, ("uri",)),
        # the node: its slave API, its URI, its start
        Hook(api, "verify_request", verify_request, _CALLER),
        Hook(api, "finish_request", finish_request, _CALLER),
        Hook(rosgraph.xmlrpc.XmlRpcNode, "set_uri", set_uri, ("self", "uri")),
        Hook(rospy.impl.init, "start_node", start_node, starts),
    ]


def install(table: list[Hook]) -> None:
    """Set every hook, or none."""
    for hook in table:
        found = getattr(hook.owner, hook.name, None)
        # Another signature is another rospy: nothing at all is replaced then.
        if found is None or (hook.parameters is not None and _parameters(found) != hook.parameters):
            raise ConfigurationError(
                f"{_path(hook)} of this rospy is not supported",
                f"rossec supports {VERSIONS[0]} to {VERSIONS[-1]}; for others use `rossec run`",
            )
    for hook in table:
        setattr(hook.owner, hook.name, hook.new)
    check(table)


def hook_tools(process: SecuredProcess) -> None:
    rosnode, rosservice = sys.modules.get("rosnode"), sys.modules.get("rosservice")
    table = []
    if rosnode is not None:
        table.append(Hook(rosnode, "ServerProxy", XmlRpcClient(process).proxy_class()))
    if rosservice is not None:
        table.append(Hook(rosservice, "socket", ModuleProxy(socket, socket=_probes(process))))
    install(table)


def _probes(process: SecuredProcess) -> Callable[..., ServiceProbe]:
    def make_probe(family: int = socket.AF_INET, kind: int = socket.SOCK_STREAM) -> ServiceProbe:
        return ServiceProbe(process, socket.socket(family, kind))

    return make_probe


def check(table: list[Hook]) -> None:
    # When the node starts, too, in case something was put back (attack F12).
    for hook in table:
        if inspect.getattr_static(hook.owner, hook.name, None) is not hook.new:
            raise ConfigurationError(
                f"{_path(hook)} was replaced after rossec.secure()",
                "import what replaces it before rossec.secure()",
            )


def _parameters(function: Any) -> tuple[str, ...]:
    target = vars(function)["__init__"] if isinstance(function, type) else function
    return tuple(inspect.signature(target).parameters)


def _path(hook: Hook) -> str:
    owner = hook.owner
    return f"{getattr(owner, '__module__', '')} {owner.__name__}.{hook.name}".strip()


def _as_function(method: Callable[..., Any]) -> Callable[..., Any]:
    def function(*arguments: Any) -> Any:
        return method(*arguments)

    return function
