"""`rossec.secure()`: every connection that rospy opens afterwards is secured.

It ends the program if it fails: called too late, without an identity, with an unsupported rospy, or
again with other options. The node's identity is loaded when its name is known: from the options; else
when it is first needed, if `__name:=` gives the name; else in `rospy.init_node`.
"""

import importlib
import logging
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NoReturn

from ca.errors import HintedError
from ca.keys import ownership
from rossec import environment, files, peer_limits
from rossec.channel.opening import post_quantum
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.host.addresses import warn_of_own_address
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.options import Options, PlainPeers, file_of, read
from rossec.inprocess.process import CallReporter, LogBridge, SecuredProcess
from rossec.ros.names import own_address, parse_uri

_MAX_FILE = 64 * 1024


class _Secured:
    def __init__(self, options: Options) -> None:
        self.options = options
        try:  # it imports rospy, which `rossec` alone must not
            self.hooks: Any = importlib.import_module("rossec.inprocess.hooks")
        except ModuleNotFoundError as error:
            raise ConfigurationError(
                f"rospy is not installed: {error}", "install ROS, or use rossec.node, which does not need it"
            ) from error
        self.hooks.rospy_version()
        self.hooks.check_in_time()
        self._rospy = importlib.import_module("rospy")
        self.reporter = CallReporter(lambda line: self._rospy.logwarn("%s", line))
        self.process = SecuredProcess(self.reporter, PlainPeers(options.allow_plain))
        self._stock_start: Callable[..., Any] = self._rospy.impl.init.start_node
        self.table = self.hooks.hooks(self.process, self.start_node)

    def install(self) -> None:
        name = None if self.options.node is None else self._early_name()
        if name is not None:
            local_identity = self._load_identity(name)
            self.hooks.install(self.table)
            self._begin(local_identity)
        else:
            options = self.options
            if not any((options.home / "nodes").glob("*/node.pem")):
                raise ConfigurationError(
                    f"no node is enrolled in {options.home}", environment.missing_nodes(options.home)
                )
            self.hooks.install(self.table)
            self.process.begin_early = self._begin_early
        logging.getLogger("rossec").addHandler(LogBridge(self.reporter))
        for entry in self.options.allow_plain:
            self.reporter.warn(f"PLAIN: allow_plain leaves {entry} open to every peer")

    def start_node(
        self,
        environ: Mapping[str, str],
        resolved_name: str,
        master_uri: str | None = None,
        port: int = 0,
        tcpros_port: int = 0,
    ) -> Any:
        # Once more: something may have put back what was replaced (F12).
        try:
            self.hooks.check(self.table)
            self.hooks.hook_tools(self.process)
            if not self.process.has_begun:
                self._begin(self._load_identity(resolved_name))
            elif resolved_name != self.process.local_identity.name:
                raise ConfigurationError(
                    f"this program is secured as {self.process.local_identity.name},"
                    f" but rospy.init_node names it {resolved_name}",
                    "give both the same name, or only rospy.init_node",
                )
        except HintedError as error:
            _refuse_start(error)
        importlib.import_module("rossec.inprocess.publishing").forked_node.start(self.reporter.warn)
        background_loop, core = self.process.background_loop, self._rospy.core
        background_loop.on_publishers = self._publishers_changed
        background_loop.on_crash = lambda: self._rospy.signal_shutdown("rossec: the background loop failed")
        core.add_shutdown_hook(lambda _: background_loop.stop())
        return self._stock_start(environ, resolved_name, master_uri, port, tcpros_port)

    def _early_name(self) -> str | None:
        given, names = self.options.node, self._rospy.names
        if given is not None and given.startswith("/"):
            return given
        base = names.get_mappings().get("__name", given)
        if base is None:
            return None
        graph: Any = importlib.import_module("rosgraph.names")
        return str(graph.resolve_name(base, names.get_caller_id()))

    def _begin_early(self) -> None:
        name = self._early_name()
        if name is not None:
            self._begin(self._load_identity(name))

    def _load_identity(self, name: str) -> LocalIdentity:
        home = NodeHome.find(self.options.home, name)
        return LocalIdentity(home, name, post_quantum(os.environ), environment.own_master(os.environ))

    def _begin(self, local_identity: LocalIdentity) -> None:
        self.hooks.hook_tools(self.process)
        uri = importlib.import_module("rosgraph").get_master_uri()
        self.process.begin(local_identity, parse_uri(uri, "ROS_MASTER_URI"))
        warn = partial(self.reporter.warn, "the address of this node")
        warn_of_own_address(own_address(os.environ), os.environ, warn)

    def _publishers_changed(self, topic: str, uris: list[str]) -> None:
        registration = self._rospy.impl.registration
        for listener in registration.get_registration_listeners().listeners:
            if isinstance(listener, registration.RegManager):
                listener.publisher_update(topic, uris)


_secured: _Secured | None = None


def secure(node: str | None = None, *, allow_plain: Sequence[str] | None = None) -> None:
    """Secure every connection of this process; call it right after `import rospy`.

    Args:
        node: the name of the node, if it must be known before `rospy.init_node`: as given to that,
            or absolute.
        allow_plain: what may stay plain while a fleet migrates: topics, services, addresses.

    Ends the program, with a hint, if it cannot be secured.
    """
    global _secured  # noqa: PLW0603 - a process is secured once
    try:
        if _secured is not None:  # modules of one program may each call it
            now = _options(node, allow_plain)
            if _secured.options != now:
                raise ConfigurationError(
                    "rossec.secure() was called already, with other options",
                    "call it once, or everywhere with the same",
                )
            return
        _start_block.remove()
        made = _Secured(_options(node, allow_plain))
        made.install()
    except HintedError as error:
        # A process that survives this, as a notebook does, can start no node.
        if _secured is None:
            _start_block.set(error)
        stop(error)
    _secured = made


class _StartBlock:
    _stock: Callable[..., Any] | None = None

    def set(self, error: HintedError) -> None:
        try:
            init: Any = importlib.import_module("rospy.impl.init")
        except ImportError:
            return  # no rospy, no node
        self._stock = init.start_node
        init.start_node = lambda *_, **__: _refuse_start(error)

    def remove(self) -> None:
        if self._stock is not None:
            init: Any = importlib.import_module("rospy.impl.init")
            init.start_node, self._stock = self._stock, None


_start_block: Final = _StartBlock()


def secured() -> SecuredProcess:
    if _secured is None:
        raise ConfigurationError("this program is not secured", "call rossec.secure() first")
    return _secured.process


def stop(error: HintedError) -> NoReturn:
    """Report `error` on the terminal and end the program: it must not run unsecured."""
    sys.stderr.write(f"rossec: error: {peer_limits.printable(error)}\n")
    if error.hint:
        sys.stderr.write(f"rossec: hint: {peer_limits.printable(error.hint)}\n")
    sys.stderr.flush()
    raise SystemExit(1) from error


def _refuse_start(error: HintedError) -> NoReturn:
    # Else rospy would take the next `init_node` for a repetition, and do nothing.
    client: Any = importlib.import_module("rospy.client")
    client._init_node_args = None  # noqa: SLF001 - rospy's
    stop(error)


def _options(node: str | None, allow_plain: Sequence[str] | None) -> Options:
    path = file_of(os.environ)
    text = None
    if path.exists():
        missing = ConfigurationError(f"{path} cannot be read")
        text = files.read_own(path, _MAX_FILE, missing, link=True).decode(errors="replace")
    elif "ROSSEC_CONFIG" in os.environ:
        raise ConfigurationError(f"ROSSEC_CONFIG names {path}, which does not exist")
    options = read(os.environ, text, node=node, allow_plain=allow_plain)
    ownership.check_directory(options.home)
    return options
