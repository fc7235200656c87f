"""The hooks: exactly what is replaced in rospy and rosgraph.

A hook names a module, an attribute path and the parameters its stock function must have: a rospy
in which one of them differs is refused before anything is replaced. `check` repeats the check when
the node starts, in case something was put back (attack F12).
"""

import inspect
import socket
import sys
import threading
import xmlrpc.client
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, NamedTuple

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
from rossec.inprocess.addresses import bracketed, parse_rosrpc
from rossec.inprocess.connections import Connections
from rossec.inprocess.module_proxy import ModuleProxy
from rossec.inprocess.process import SecuredProcess
from rossec.inprocess.publishing import forked_node, publish
from rossec.inprocess.send_queue import write_data
from rossec.inprocess.service_probe import ServiceProbe
from rossec.inprocess.sockets import RosSocket
from rossec.inprocess.subscription import SubscriptionLoop
from rossec.inprocess.wish_queue import queue_for
from rossec.inprocess.xmlrpc_client import REQUEST, XmlRpcClient
from rossec.inprocess.xmlrpc_server import XmlRpcServer
from rossec.ros.settings import parse_uri

VERSIONS: Final = ("1.14", "1.15", "1.16", "1.17")
_LATE: Final = "call rossec.secure() right after importing rospy, before anything else of it"

_CALLER: Final = ("self", "request", "client_address")

StartNode = Callable[..., Any]


class Hook(NamedTuple):
    """`owner.name` becomes `new`; `parameters` are those of the function that was there."""

    owner: Any
    name: str
    new: object
    parameters: tuple[str, ...] | None = None


def rospy_version() -> str:
    """The version of the rospy that is imported.

    Raises:
        ConfigurationError: unknown, or not a version that rossec was tested with.
    """
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
    """Check that the program has opened no connection yet: it would stay plain.

    Raises:
        ConfigurationError: it has opened one.
    """
    base, core = rospy.impl.tcpros_base, rospy.core
    if core.is_initialized() or rospy.client._init_node_args:  # noqa: SLF001 - rospy has no function for it
        raise ConfigurationError("rossec.secure() comes after rospy.init_node()", _LATE)
    if base._tcpros_server is not None or core._xmlrpc_cache:  # noqa: SLF001 - rospy's
        raise ConfigurationError("rospy has connected already, without rossec", _LATE)
    topics = rospy.impl.registration.get_topic_manager()
    if topics.get_topics():
        raise ConfigurationError("a topic was created before rossec.secure()", _LATE)


def hooks(process: SecuredProcess, start_node: StartNode) -> list[Hook]:
    """Every hook, in the order in which they are set."""
    return [
        *_connection_hooks(process),
        *_topic_hooks(process),
        *_xmlrpc_client_hooks(process),
        *_wait_hooks(process),
        *_node_hooks(process),
        Hook(
            rospy.impl.init, "start_node", start_node,
            ("environ", "resolved_name", "master_uri", "port", "tcpros_port"),
        ),
    ]  # fmt: skip


def _connection_hooks(process: SecuredProcess) -> list[Hook]:
    """TCPROS connections of topics and services, both sides."""
    transport = rospy.impl.tcpros_base.TCPROSTransport
    connections = Connections(process)

    def make(family: int = socket.AF_INET, kind: int = socket.SOCK_STREAM) -> RosSocket:
        return RosSocket(process, socket.socket(family, kind))

    def accepted(tcpros: Any, sock: RosSocket, where: Any) -> None:
        arguments = (tcpros, sock, where)
        try:
            threading.Thread(target=connections.serve, args=arguments, daemon=True).start()
        except RuntimeError:  # out of threads: only this caller is dropped
            sock.close()

    server = rospy.impl.tcpros_base.TCPROSServer
    probes = ModuleProxy(socket, socket=_probes(process))
    return [
        Hook(rospy.impl.tcpros_base, "socket", ModuleProxy(socket, socket=make)),
        Hook(rospy.impl.tcpros_service, "socket", probes),
        Hook(server, "_tcp_server_callback", accepted, ("self", "sock", "client_addr")),
        Hook(transport, "write_header", _as_function(connections.write_header), ("self",)),
        Hook(transport, "read_header", _as_function(connections.read_header), ("self",)),
        Hook(transport, "write_data", write_data, ("self", "data")),
    ]


def _topic_hooks(process: SecuredProcess) -> list[Hook]:
    """Sending and receiving messages."""
    pubsub, queued = rospy.impl.tcpros_pubsub, ("self", "connection", "queue_size")
    return [
        Hook(
            pubsub, "robust_connect_subscriber", SubscriptionLoop(process).run,
            ("conn", "dest_addr", "dest_port", "pub_uri", "receive_cb", "resolved_topic_name"),
        ),
        Hook(
            rospy.topics._PublisherImpl, "publish", publish,  # noqa: SLF001 - rospy's
            ("self", "message", "connection_override"),
        ),
        Hook(rospy.topics, "QueuedConnection", queue_for, queued),
        Hook(pubsub, "QueuedConnection", queue_for, queued),
    ]  # fmt: skip


def _xmlrpc_client_hooks(process: SecuredProcess) -> list[Hook]:
    """Calls of the master API and of the slave APIs of other nodes."""
    client = XmlRpcClient(process)
    proxy = client.proxy_class()
    return [
        Hook(rospy.core, "xmlrpcclient", ModuleProxy(xmlrpc.client, ServerProxy=proxy)),
        Hook(rospy.core, "_LockedServerProxy", proxy, ("self", "args", "kwargs")),
        Hook(rospy.impl.tcpros_pubsub, "ServerProxy", proxy),
        Hook(rosgraph.masterapi, "ServerProxy", proxy),
        Hook(rosgraph.impl.graph, "ServerProxy", proxy),
        Hook(
            xmlrpc.client.ServerProxy, REQUEST, _as_function(client.request),
            ("self", "methodname", "params"),
        ),
    ]  # fmt: skip


def _wait_hooks(process: SecuredProcess) -> list[Hook]:
    """`wait_for_service`, and the URIs of services."""
    service = rospy.impl.tcpros_service
    stock_wait = service.wait_for_service

    def wait_for_service(service: Any, timeout: Any = None) -> None:
        process.require_name()  # rospy's loop would catch the error and never end
        stock_wait(service, timeout)

    def parse_service_uri(uri: str) -> tuple[str, int]:
        try:
            return parse_rosrpc(uri)
        except ConfigurationError as error:
            raise ParameterInvalid(str(error)) from error

    return [
        Hook(service, "wait_for_service", wait_for_service, ("service", "timeout")),
        Hook(rospy, "wait_for_service", wait_for_service, ("service", "timeout")),
        Hook(rospy.core, "parse_rosrpc_uri", parse_service_uri, ("uri",)),
    ]


def _node_hooks(process: SecuredProcess) -> list[Hook]:
    """This node's slave API and its URI."""
    api = rosgraph.xmlrpc.ThreadingXMLRPCServer
    server = XmlRpcServer(process)

    def set_uri(node: Any, uri: str) -> None:
        node.uri = bracketed(uri)
        host, port = parse_uri(node.uri)
        process.listens(port, host)

    return [
        Hook(api, "verify_request", _as_function(server.verify_request), _CALLER),
        Hook(api, "finish_request", _as_function(server.finish_request), _CALLER),
        Hook(rosgraph.xmlrpc.XmlRpcNode, "set_uri", set_uri, ("self", "uri")),
    ]


def install(table: list[Hook]) -> None:
    """Set every hook, or none.

    Raises:
        ConfigurationError: this rospy is not the one the hooks are for.
    """
    for hook in table:
        found = getattr(hook.owner, hook.name, None)
        if found is None or (hook.parameters is not None and _parameters(found) != hook.parameters):
            raise ConfigurationError(
                f"{_path(hook)} of this rospy is not supported",
                f"rossec supports {VERSIONS[0]} to {VERSIONS[-1]}; for others use `rossec run`",
            )
    for hook in table:
        setattr(hook.owner, hook.name, hook.new)
    check(table)


def hook_tools(process: SecuredProcess) -> None:
    """Hook the ROS tools that the program imported: they connect to nodes themselves."""
    rosnode, rosservice = sys.modules.get("rosnode"), sys.modules.get("rosservice")
    table = []
    if rosnode is not None:
        table.append(Hook(rosnode, "ServerProxy", XmlRpcClient(process).proxy_class()))
    if rosservice is not None:
        table.append(Hook(rosservice, "socket", ModuleProxy(socket, socket=_probes(process))))
    install(table)


def watch_forks(process: SecuredProcess) -> None:
    """The node starts: a child forked from now on says that nobody receives it."""
    forked_node.start(process.reporter.warn)


def _probes(process: SecuredProcess) -> Callable[..., ServiceProbe]:
    def make_probe(family: int = socket.AF_INET, kind: int = socket.SOCK_STREAM) -> ServiceProbe:
        return ServiceProbe(process, socket.socket(family, kind))

    return make_probe


def check(table: list[Hook]) -> None:
    """Check that every hook is in place.

    Raises:
        ConfigurationError: one was replaced.
    """
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
    """`method` as a function, which becomes a method of the class it is set on."""

    def function(*arguments: Any) -> Any:
        return method(*arguments)

    return function
