"""The sidecar of a host or of one program: a master on loopback, and an agent for each identity.

A shell. The identity of a call follows from the caller_id, never from data of a peer: with
`identity` it is always that one; otherwise each program uses the one enrolled for its name. The
caller_id of roscpp's `NodeHandle::searchParam` is a namespace of its node: there it is the program.
"""

import asyncio
import logging
from functools import partial
from pathlib import Path
from typing import Final

from ca.errors import HintedError, NameRefused
from ca.names import check_name
from rossec import home_hints
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.opening import WireProtocol
from rossec.errors import ConfigurationError, HangUp
from rossec.home import NodeHome
from rossec.net.halfopen import HalfOpen, HalfOpenCount
from rossec.net.rpc.client import serve_calls
from rossec.participant.caller_names import SEARCH
from rossec.participant.slave_api import without_caller
from rossec.ros.names import MASTER
from rossec.ros.settings import Settings, is_loopback
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.agent import Agent
from rossec.sidecar.callers import Callers
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.master_calls import MULTICALL, rule_of
from rossec.sidecar.loopback_port import LoopbackPort
from rossec.sidecar.plain_stream import PlainStream

_TAKEN: Final = "is roscore or another sidecar running? choose another port with --port"
_log = logging.getLogger("rossec.sidecar")
LIMIT: Final = 256  # identities in use


class Sidecar:
    """Serves the programs that `callers` allows.

    Args:
        home: ROSSEC_HOME.
        settings: where the secured master is, and how peers reach this host.
        identity: the name whose identity every program uses, if any.
        each: programs with their own identity use that instead.
        port: of the loopback master; 0 for any.
        suites: cipher suites of the channel, offered and accepted.
        master_name: the certified name of the secured master.
    """

    def __init__(
        self,
        home: Path,
        settings: Settings,
        callers: Callers,
        *,
        identity: str | None = None,
        each: bool = False,
        port: int = 0,
        suites: tuple[int, ...] = PRODUCTION,
        master_name: str = MASTER,
    ) -> None:
        self._home = home
        self._settings = settings
        self._callers = callers
        self._each = each
        self._suites = suites
        self._master_name = master_name
        self._half_open = HalfOpenCount(HalfOpen())
        self._agents: dict[str, Agent] = {}
        self._master = self._bind_master(port)
        self._default = None if identity is None else self._agent(NodeHome.of(home, identity))

    @property
    def uri(self) -> str:
        """The ROS_MASTER_URI for programs."""
        return Endpoint(WireProtocol.HTTP, self._callers.loopback.host, self._master.port).uri

    def _bind_master(self, port: int) -> LoopbackPort:
        try:
            master = LoopbackPort(self._callers, self._serve, port)
        except OSError as error:
            address = self._callers.loopback.address
            raise ConfigurationError(
                f"cannot listen at {address} port {port}: {error.strerror}", _TAKEN
            ) from error
        if is_loopback(self._settings.master_host) and self._settings.master_port == master.port:
            raise ConfigurationError(
                f"ROS_MASTER_URI, {self._settings.master_uri}, is the sidecar's own address",
                "set it to where the secured master is, for the sidecar alone",
            )
        return master

    def start(self) -> None:
        """Start to accept programs."""
        self._master.open()

    async def close(self) -> None:
        """Close all connections."""
        await self._master.close()
        await asyncio.gather(*(agent.close() for agent in self._agents.values()))

    async def _serve(self, program: PlainStream) -> None:
        await serve_calls(program, partial(self._dispatch, program), compact=False)

    async def _dispatch(
        self, program: PlainStream, method: str, params: tuple[object, ...], _: str
    ) -> object:
        if method == MULTICALL and params == ([],):  # no caller: roslaunch without parameters
            return []
        refused = _missing_caller(method, params)
        if refused is not None:
            return refused
        try:
            name = _caller(method, params)
            agent = await self._searching(program, name) if method == SEARCH else None
            agent = agent or self._agent_for(name)
            return await agent.handle_call(method, params)
        except (HangUp, Fault):
            raise
        except HintedError as error:
            _log.warning("%s: %s (%s)", method, error, error.hint)
            return [-1, f"rossec: {error} ({error.hint})", 0]
        except OSError as error:  # the files of the identity cannot be read
            _log.warning("%s: %s", method, error)
            return [-1, f"rossec: {error}", 0]

    async def _searching(self, program: PlainStream, space: str) -> Agent | None:
        """The agent of the program that searches from `space`; None: that of the name `space`.

        Several nodes in `space`, or one that has this very name: the process decides.
        """
        if self._default is not None and not self._each:
            return None
        prefix = space.rstrip("/") + "/"
        nodes = [
            (agent, api)
            for agent in self._agents.values()
            for api, node in agent.state.programs.items()
            if f"{node.name}/".startswith(prefix)
        ]
        agents = {agent for agent, _ in nodes}
        if len(agents) == 1 and not self._is_enrolled(space):
            return agents.pop()
        for agent, api in nodes:
            if await self._callers.is_program_at(program.socket, api.port):
                return agent
        return None

    def _is_enrolled(self, name: str) -> bool:
        try:
            return (NodeHome.find(self._home, check_name(name)).path / "node.key").exists()
        except NameRefused:
            return False

    def _agent_for(self, name: str) -> Agent:
        if self._default is not None and not self._each:
            return self._default
        try:
            # rosparam uses /rosparam-1234, an invalid ROS name; it means an anonymous one.
            home = NodeHome.find(self._home, check_name(name.replace("-", "_")))
        except NameRefused:
            if self._default is not None:
                return self._default
            raise
        if home.name in self._agents:
            return self._agents[home.name]
        if not (home.path / "node.key").exists():
            if self._default is not None:
                return self._default
            hint = f"{home_hints.missing_node(self._home, name)}; or use --as"
            raise ConfigurationError(f"{name} has no identity here", hint)
        if len(self._agents) >= LIMIT:
            raise ConfigurationError("too many identities in one sidecar")
        return self._agent(home)

    def _agent(self, home: NodeHome) -> Agent:
        if home.name not in self._agents:
            self._agents[home.name] = Agent(
                home, self._settings, self._callers, self.uri, self._half_open, self._suites,
                self._master_name,
            )  # fmt: skip
        return self._agents[home.name]


def _missing_caller(method: str, params: tuple[object, ...]) -> object | None:
    """The refusal of a call without caller_id; it needs no identity."""
    return None if method == MULTICALL else without_caller(params, rule_of(method).default)


def _caller(method: str, params: tuple[object, ...]) -> str:
    """The caller_id of a call; of a multicall, the first in its elements."""
    if method != MULTICALL:
        return str(params[0])
    for element in params[0] if params and isinstance(params[0], list) else ():
        match element:
            case {"params": [str() as name, *_]}:
                return name
            case _:
                pass
    raise Fault(1, "missing required caller_id parameter")
