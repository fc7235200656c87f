"""The running master: accepts secure connections, dispatches calls, sends answers. A shell.

Decisions are elsewhere: access control authorizes calls, `TrustState` tells which grants are valid,
the registry returns events. All state is used in one event loop, and a call is answered without
waiting for any peer, so no locks are needed. The effects of events are in `effects`, periodic work
in `maintenance`, connections to nodes in `dialer`.
"""

import asyncio
import contextlib
import logging
import os
import secrets
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.channel.edhoc.credentials import OwnCredential, Verify
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.records import ChannelLimits
from rossec.clock import time as host_time
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import RevocationsChanged, StopMaster
from rossec.master.api.revoked_calls import CONNECTION_SECONDS, RevokedCalls, RevokedConnections
from rossec.master.api.turns import Turns
from rossec.master.operation.denial_limit import DENIALS
from rossec.master.operation.denial_log import OnDenial, ignore_denial
from rossec.master.operation.limits import MasterLimits
from rossec.master.rights.statements import TrustState
from rossec.master.server.answers import CallAnswers
from rossec.master.server.dialer import SlaveDialer
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.local_authority import (
    SOURCE,
    FindRevocations,
    LocalAuthority,
    no_authority,
)
from rossec.master.server.maintenance import Maintenance
from rossec.master.server.parameter_file import ParameterFile
from rossec.master.server.updates import MAX_CLOSING, Updates
from rossec.master.state.parameters import Parameters
from rossec.master.state.registry import Kind, NodeRef, Registry
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.net.halfopen import HalfOpen, HalfOpenCount
from rossec.net.rpc.client import serve_calls
from rossec.ros.http import HEADERS_LIMIT
from rossec.ros.settings import is_loopback
from rossec.ros.text import printable

DEFAULT_NAME: Final = "/master"
TIMESTAMP_EVERY: Final = 10.0  # seconds; a timestamp is valid for 30
_LIMITS: Final = MasterLimits()
PEER_CONNECTIONS: Final = _LIMITS.connections_per_identity

_denials = logging.getLogger(DENIALS)


class MasterServer:
    """The master; not a context manager: `start`, then `stopped` or `close`.

    Args:
        credentials, verify: the master's own identity, and verification of the peers'.
        trust: grants and revocations.
        name: the master's certified name.
        host: address to listen on (None: all). port: 0 for any free one.
        advertise: host name in `uri`, which nodes are sent.
        clock: seconds since the epoch.
        parameter_file: the journal of parameters; None: they do not survive a restart.
        limits: limits on what one peer may use.
        suites: the post-quantum policy (`rossec.channel.suite_selection`).
        check_own_identity: called with the time in each round of maintenance.
        turns: limits how long one call may delay others.
        find_revocations: reads what an authority on this host has signed.
    """

    def __init__(
        self,
        credentials: OwnCredential,
        verify: Verify[Identity],
        trust: TrustState,
        *,
        name: str = DEFAULT_NAME,
        host: str | None = None,
        port: int = 11311,
        advertise: str = "localhost",
        clock: Callable[[], float] = host_time,
        timestamp_every: float = TIMESTAMP_EVERY,
        on_denial: OnDenial = ignore_denial,
        parameter_file: ParameterFile | None = None,
        limits: MasterLimits = _LIMITS,
        suites: tuple[int, ...] = PRODUCTION,
        check_own_identity: Callable[[int], None] = lambda _: None,
        turns: Turns | None = None,
        find_revocations: FindRevocations = no_authority,
    ) -> None:
        self._trust = trust
        self._name = name
        self._address = (host, port)
        self._advertise = advertise
        self._clock = clock
        self._parameter_file = parameter_file
        self._limits = limits
        self._turns = Turns(time.monotonic) if turns is None else turns
        channel_limits = ChannelLimits(
            unit=limits.body + HEADERS_LIMIT, handshake_seconds=limits.handshake_seconds
        )
        self._context = SecureContext(
            credentials,
            verify,
            suites=suites,
            known=KnownCertificates(),
            dial_limits={WireProtocol.HTTP: channel_limits},
            accept_limits={WireProtocol.HTTP: channel_limits},
            half_open=HalfOpenCount(HalfOpen(limits.unfinished_per_address, limits.unfinished)),
        )
        self._registry = Registry(limits.nodes_per_identity)
        self._answers: CallAnswers | None = None
        self._server: SecureServer[Identity] | None = None
        self._revoked_connections = RevokedConnections()
        self._dialer = SlaveDialer(self._context, self._on_mismatch)
        self._updates = Updates(self._dialer.dial, limits.nodes_per_identity + MAX_CLOSING)
        self._state = state = MasterState(
            name, self._now, self._registry, trust, self._updates, parameter_file
        )
        self._streams = state.streams
        self._effects = Effects(state, on_denial, self._on_revocations)
        list_changed = partial(self._effects.deliver, RevocationsChanged(SOURCE))
        local_authority = LocalAuthority(find_revocations, trust, list_changed)
        checks = (check_own_identity, local_authority.check)
        self._maintenance = Maintenance(state, self._effects.deliver, timestamp_every, checks)

    @property
    def port(self) -> int:
        """The port listened on."""
        return self._address[1] if self._server is None else self._server.port

    @property
    def uri(self) -> str:
        """The value for ROS_MASTER_URI."""
        host = f"[{self._advertise}]" if ":" in self._advertise else self._advertise
        return f"http://{host}:{self.port}/"

    async def start(self) -> None:
        """Listen.

        Raises:
            OSError: the address is not of this host, or the port is in use.
        """
        (host, port), limits = self._address, self._limits
        self._server = serve(self._handle, host, port, self._context, WireProtocol.HTTP)
        api = MasterApi(
            self._registry,
            self._trust,
            name=self._name,
            uri=self.uri,
            pid=os.getpid(),
            instance=secrets.token_hex(8),
            started=self._now(),
            parameters=self._load_parameters(),
            parameter_bytes=limits.parameters,
        )
        self._answers = CallAnswers(api, self._state, self._effects, self._dialer, self._turns)
        self._maintenance.start(api)

    def _load_parameters(self) -> Parameters | None:
        if self._parameter_file is None:
            return None
        self._parameter_file.open()
        return self._parameter_file.parameters

    def status(self) -> dict[str, str | int]:
        """Figures for administrators and metrics."""
        entries = [entry for kind in Kind for entry in self._registry.entries(kind)]
        return {
            "uri": self.uri,
            "pid": os.getpid(),
            "calls": self._effects.calls,
            "denials": self._effects.denials,
            "nodes": len(tuple(self._registry.nodes())),
            "registrations": sum(len(names) for _, names in entries),
            "connections": 0 if self._server is None else self._server.connections,
            "revocation_number": self._trust.number,
        }

    def stop(self, reason: str) -> None:
        """Stop, as requested by an administrator."""
        self._effects.deliver(StopMaster(reason))

    async def stopped(self) -> None:
        """Wait until an administrator stops the master."""
        await self._effects.stopping.wait()

    async def close(self) -> None:
        """Stop listening, close all connections, stop sending updates."""
        await self._maintenance.close()
        await self._updates.close()
        if self._server is not None:
            await self._server.close()
        if self._parameter_file is not None:
            self._parameter_file.close()

    async def _handle(self, stream: SecureStream[Identity]) -> None:
        key = stream.peer.thumbprint
        open_connections = sum(other.peer.thumbprint == key for other in self._streams)
        if open_connections >= self._limits.connections_per_identity:
            _denials.warning("%s has too many connections", stream.peer.name)
            stream.abort("too many connections of one identity")
            return
        try:
            self._trust.caller(stream.peer, self._now())
        except HintedError as error:
            _denials.warning(
                "%s is sent only the revocation list: %s", stream.peer.name, printable(error)
            )
            await self._serve_revoked(stream)
            return
        self._streams.add(stream)  # until its socket is closed: a lingering one counts
        stream.when_closed(partial(self._streams.discard, stream))
        is_local = is_loopback(stream.address) or stream.address == stream.local_address
        await serve_calls(
            stream,
            partial(self._dispatch, is_local),
            limit=self._limits.body,
            request_deadline=self._limits.request_seconds,
            idle_deadline=self._limits.idle_seconds,
        )

    async def _serve_revoked(self, stream: SecureStream[Identity]) -> None:
        """Answer for a few seconds; not one of the streams, so it is sent no updates."""
        keys = stream.peer.keys
        if not self._revoked_connections.admit(keys):
            stream.abort("too many connections of a revoked identity")
            return
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CONNECTION_SECONDS):
                    answer = RevokedCalls(self._trust, self._now).answer
                    await serve_calls(stream, answer, limit=self._limits.body)
        finally:
            stream.abort("the identity is revoked")
            self._revoked_connections.release(keys)

    def _dispatch(
        self, is_local: bool, method: str, params: tuple[object, ...], peer: Identity
    ) -> object:
        if self._answers is None:
            raise RuntimeError("a call before the master was started")
        return self._answers.dispatch(is_local, method, params, peer)

    def _on_mismatch(self, node: NodeRef, found: Identity) -> None:
        self._effects.evict(node, found)

    def _on_revocations(self) -> None:
        self._maintenance.revocations_changed()

    def _now(self) -> int:
        return int(self._clock())
