"""What is replaced in rospy and rosgraph, exactly; nothing else is touched.

A hook names a module, an attribute path and the parameters its stock function must have: a rospy
in which one of them differs is refused before anything is replaced. `check` looks again when the
node starts, so that nothing can have been put back (attack F12).
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
from rossec.inprocess.publishing import publish
from rossec.inprocess.send_queue import SendQueue, write_data
from rossec.inprocess.service_probe import ServiceProbe
from rossec.inprocess.sockets import RosSocket
from rossec.inprocess.subscription import SubscriptionLoop
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
        ConfigurationError: unknown, or none that rossec was tried with.
    """
    try:
        found = version("rospy")
    except PackageNotFoundError:
        found = ""
    if not found.startswith(tuple(f"{known}." for known in VERSIONS)):
        raise ConfigurationError(
            f"rospy {found or 'of unknown version'} is none that rossec knows",
            f"rossec knows {VERSIONS[0]} to {VERSIONS[-1]}; for others use `rossec run`",
        )
    return found


def check_in_time() -> None:
    """Refuse a program that has opened connections already: they would stay plain.

    Raises:
        ConfigurationError: it has.
    """
    base, core = rospy.impl.tcpros_base, rospy.core
    if core.is_initialized() or rospy.client._init_node_args:  # noqa: SLF001 - rospy has no question for it
        raise ConfigurationError("rossec.secure() comes after rospy.init_node()", _LATE)
    if base._tcpros_server is not None or core._xmlrpc_cache:  # noqa: SLF001 - rospy's
        raise ConfigurationError("rospy has connected already, without rossec", _LATE)
    topics = rospy.impl.registration.get_topic_manager()
    if topics.get_topics():
        raise ConfigurationError("a topic was made before rossec.secure()", _LATE)


def hooks(process: SecuredProcess, start_node: StartNode) -> list[Hook]:
    """Every hook, in the order in which they are set."""
    base, pubsub = rospy.impl.tcpros_base, rospy.impl.tcpros_pubsub
    service, transport = rospy.impl.tcpros_service, rospy.impl.tcpros_base.TCPROSTransport
    api = rosgraph.xmlrpc.ThreadingXMLRPCServer
    connections, server = Connections(process), XmlRpcServer(process)
    client = XmlRpcClient(process)
    proxy = client.proxy_class()

    def make(family: int = socket.AF_INET, kind: int = socket.SOCK_STREAM) -> RosSocket:
        return RosSocket(process, socket.socket(family, kind))

    def set_uri(node: Any, uri: str) -> None:
        node.uri = bracketed(uri)
        host, port = parse_uri(node.uri)
        process.listens(port, host)

    def parse_service_uri(uri: str) -> tuple[str, int]:
        try:
            return parse_rosrpc(uri)
        except ConfigurationError as error:
            raise ParameterInvalid(str(error)) from error

    stock_wait = service.wait_for_service

    def wait_for_service(service: Any, timeout: Any = None) -> None:
        process.require_name()  # rospy's loop would swallow why, and go on for ever
        stock_wait(service, timeout)

    def accepted(tcpros: Any, sock: RosSocket, where: Any) -> None:
        arguments = (tcpros, sock, where)
        try:
            threading.Thread(target=connections.serve, args=arguments, daemon=True).start()
        except RuntimeError:  # out of threads: this caller is dropped, the next may be served
            sock.close()

    return [
        Hook(base, "socket", ModuleProxy(socket, socket=make)),
        Hook(service, "socket", ModuleProxy(socket, socket=_probes(process))),
        Hook(
            base.TCPROSServer, "_tcp_server_callback", accepted, ("self", "sock", "client_addr")
        ),
        Hook(transport, "write_header", _plain(connections.write_header), ("self",)),
        Hook(transport, "read_header", _plain(connections.read_header), ("self",)),
        Hook(transport, "write_data", write_data, ("self", "data")),
        Hook(
            pubsub, "robust_connect_subscriber", SubscriptionLoop(process).follow,
            ("conn", "dest_addr", "dest_port", "pub_uri", "receive_cb", "resolved_topic_name"),
        ),
        Hook(
            rospy.topics._PublisherImpl, "publish", publish,  # noqa: SLF001 - rospy's
            ("self", "message", "connection_override"),
        ),
        Hook(rospy.topics, "QueuedConnection", SendQueue, ("self", "connection", "queue_size")),
        Hook(pubsub, "QueuedConnection", SendQueue, ("self", "connection", "queue_size")),
        Hook(rospy.core, "xmlrpcclient", ModuleProxy(xmlrpc.client, ServerProxy=proxy)),
        Hook(rospy.core, "_LockedServerProxy", proxy, ("self", "args", "kwargs")),
        Hook(pubsub, "ServerProxy", proxy),
        Hook(rosgraph.masterapi, "ServerProxy", proxy),
        Hook(rosgraph.impl.graph, "ServerProxy", proxy),
        Hook(service, "wait_for_service", wait_for_service, ("service", "timeout")),
        Hook(rospy, "wait_for_service", wait_for_service, ("service", "timeout")),
        Hook(
            xmlrpc.client.ServerProxy, REQUEST, _plain(client.request),
            ("self", "methodname", "params"),
        ),
        Hook(api, "verify_request", _plain(server.verify_request), _CALLER),
        Hook(api, "finish_request", _plain(server.finish_request), _CALLER),
        Hook(rosgraph.xmlrpc.XmlRpcNode, "set_uri", set_uri, ("self", "uri")),
        Hook(rospy.core, "parse_rosrpc_uri", parse_service_uri, ("uri",)),
        Hook(
            rospy.impl.init, "start_node", start_node,
            ("environ", "resolved_name", "master_uri", "port", "tcpros_port"),
        ),
    ]  # fmt: skip


def install(table: list[Hook]) -> None:
    """Set every hook, or none.

    Raises:
        ConfigurationError: this rospy is not the one the hooks are for.
    """
    for hook in table:
        found = getattr(hook.owner, hook.name, None)
        if found is None or (hook.parameters is not None and _parameters(found) != hook.parameters):
            raise ConfigurationError(
                f"{_path(hook)} of this rospy is not what rossec knows",
                f"rossec knows rospy {VERSIONS[0]} to {VERSIONS[-1]}; for others use `rossec run`",
            )
    for hook in table:
        setattr(hook.owner, hook.name, hook.new)
    check(table)


def set_tools(process: SecuredProcess) -> None:
    """Hook what the program has imported of ROS's tools: they connect to nodes themselves."""
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
    """Refuse to go on when a hook is not in its place.

    Raises:
        ConfigurationError: something else took it.
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


def _plain(method: Callable[..., Any]) -> Callable[..., Any]:
    """A function, to which Python gives its instance; to a bound method it would not."""

    def function(*arguments: Any) -> Any:
        return method(*arguments)

    return function
