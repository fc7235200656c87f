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
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Final

from ca import svid
from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError
from rossec.channel.edhoc.credentials import OwnCredential, Verify
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.channel.records import ChannelLimits
from rossec.clock import time as host_time
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import StopMaster
from rossec.master.api.parameter_calls import ParameterCalls
from rossec.master.api.revoked_calls import CONNECTION_SECONDS, RevokedCalls, RevokedConnections
from rossec.master.api.turns import Turns
from rossec.master.operation.denial_limit import DENIALS
from rossec.master.operation.denial_log import OnDenial, ignore_denial
from rossec.master.operation.limits import MasterLimits
from rossec.master.rights.deposits import Deposits
from rossec.master.rights.statements import TrustState
from rossec.master.server.admission import Admission
from rossec.master.server.answers import CallAnswers
from rossec.master.server.deposit_file import DepositFile
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.gateways import Gateways
from rossec.master.server.grant_changes import WAIT, GrantChanges
from rossec.master.server.local_authority import (
    FindDomains,
    FindRevocations,
    LocalAuthority,
    no_authority,
    no_domains,
)
from rossec.master.server.maintenance import Maintenance
from rossec.master.server.parameter_file import ParameterFile
from rossec.master.server.updates import MAX_CLOSING
from rossec.master.state.mirrors import MirrorChange
from rossec.master.state.registry import Kind, Registry
from rossec.master.state.sites import Site
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.net.bounds import UNSHOWN_UNIT
from rossec.net.halfopen import HalfOpen, HalfOpenCount
from rossec.net.host.relayed import is_near
from rossec.net.rpc.client import serve_calls
from rossec.ros.httpread import HEADERS_LIMIT
from rossec.ros.names import MASTER
from rossec.ros.text import printable

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
        deposit_file: the journal of deposited grants; None: none is accepted.
        limits: limits on what one peer may use.
        suites: the post-quantum policy (`rossec.channel.suite_selection`).
        check_own_identity: called with the time in each round of maintenance.
        turns: limits how long one call may delay others.
        find_revocations, find_domains: read what an authority on this host has signed.

    Attributes:
        state: what the master knows, for its event loop.
    """

    def __init__(
        self,
        credentials: OwnCredential,
        verify: Verify[Identity],
        trust: TrustState,
        *,
        name: str = MASTER,
        host: str | None = None,
        port: int = 11311,
        advertise: str = "localhost",
        clock: Callable[[], float] = host_time,
        timestamp_every: float = TIMESTAMP_EVERY,
        on_denial: OnDenial = ignore_denial,
        parameter_file: ParameterFile | None = None,
        deposit_file: DepositFile | None = None,
        limits: MasterLimits = _LIMITS,
        suites: tuple[int, ...] = PRODUCTION,
        check_own_identity: Callable[[int], None] = lambda _: None,
        turns: Turns | None = None,
        find_revocations: FindRevocations = no_authority,
        find_domains: FindDomains = no_domains,
    ) -> None:
        self._address = (host, port)
        self._advertise = advertise
        self._limits = limits
        self._turns = Turns(time.monotonic) if turns is None else turns
        channel_limits = ChannelLimits(
            unit=limits.body + HEADERS_LIMIT, handshake_seconds=limits.handshake_seconds
        )
        unshown = replace(channel_limits, preauth_limit=min(channel_limits.unit, UNSHOWN_UNIT))
        self._context = SecureContext(
            credentials,
            verify,
            suites=suites,
            known=KnownCertificates(),
            dial_limits={WireProtocol.HTTP: channel_limits},
            accept_limits={WireProtocol.HTTP: unshown},
            half_open=HalfOpenCount(HalfOpen(limits.unfinished_per_address, limits.unfinished)),
            renews=Identity.renews,
        )
        self.state = state = MasterState(
            name, clock, Registry(limits.nodes_per_identity), trust, parameter_file, deposit_file,
            grant_changes=GrantChanges(min(WAIT, limits.idle_seconds / 2)),
        )  # fmt: skip
        trust.domains.own_sites = state.imports.own_sites
        self._effects = Effects(
            state, self._context, on_denial, limits.nodes_per_identity + MAX_CLOSING
        )
        self._maintenance = Maintenance(
            state, self._effects, timestamp_every, check_own_identity,
            LocalAuthority(find_revocations, trust, find_domains),
        )  # fmt: skip
        self._gateways = Gateways(state, self._effects)
        self._admission = Admission(state, limits)
        self._revoked_connections = RevokedConnections()
        self._parameters: ParameterCalls  # set by `start`
        self._answers: CallAnswers  # set by `start`, before a connection is handled
        self._server: SecureServer[Identity] | None = None

    @property
    def port(self) -> int:
        """The port listened on."""
        return self._address[1] if self._server is None else self._server.port

    @property
    def uri(self) -> str:
        """The value for ROS_MASTER_URI."""
        host = f"[{self._advertise}]" if ":" in self._advertise else self._advertise
        return f"http://{host}:{self.port}/"

    @property
    def context(self) -> SecureContext[Identity]:
        """The master's own identity, to dial with."""
        return self._context

    @property
    def effects(self) -> Effects:
        """Delivers events that do not come from a call."""
        return self._effects

    async def start(self) -> None:
        """Listen.

        Raises:
            OSError: the address is not of this host, or the port is in use.
        """
        state, parameters = self.state, None
        self._server = serve(self._handle, *self._address, self._context, WireProtocol.HTTP)
        if state.parameter_file is not None:
            state.parameter_file.open()
            parameters = state.parameter_file.parameters
        api = MasterApi(
            state.registry,
            state.trust,
            name=state.name,
            uri=self.uri,
            pid=os.getpid(),
            instance=secrets.token_hex(8),
            started=state.now(),
            parameters=parameters,
            parameter_bytes=self._limits.parameters,
            deposits=self._load_deposits(),
            denials=state.recent_denials,
            connected=lambda: [stream.peer for stream in state.streams],
            imports=state.imports,
            aliases=state.aliases,
            doors=state.doors,
        )
        self._parameters = api.parameters
        self._answers = CallAnswers(api, state, self._effects, self._turns)
        self._maintenance.start(api.keep_views)
        self._gateways.start()

    def _load_deposits(self) -> Deposits | None:
        file = self.state.deposit_file
        if file is None:
            return None
        file.open()
        self._effects.drop_deposits()
        return file.deposits

    def mirror(self, site: Site, tree: dict[str, object]) -> None:
        """Take over the mirrored parameters of a site, and update their subscribers.

        Raises:
            ImportRefused: as `Mirrors.replace`.
        """
        self._send_mirrored(self.state.imports.mirrors.replace(site, tree))

    def drop_mirror(self, label: str) -> None:
        """Forget the mirrored parameters of a site."""
        self._send_mirrored(self.state.imports.mirrors.drop(label))

    def _send_mirrored(self, changes: Iterable[MirrorChange]) -> None:
        for event in self._parameters.mirror(changes, self.state.now()):
            self._effects.deliver(event)

    def status(self) -> dict[str, str | int]:
        """Figures for administrators and metrics."""
        registry = self.state.registry
        entries = [entry for kind in Kind for entry in registry.entries(kind)]
        own = svid.parse(self._context.credentials.certificate)
        return {
            "uri": self.uri,
            "pid": os.getpid(),
            "calls": self._effects.calls,
            "denials": self._effects.denials,
            "nodes": len(tuple(registry.nodes())),
            "registrations": sum(len(names) for _, names in entries),
            "connections": 0 if self._server is None else self._server.connections,
            "revocation_number": self.state.trust.number,
            "domains": len(self.state.trust.domains.anchors.all_listed),
            "domains_number": self.state.trust.domains.number,
            "identity_expires": svid.validity(own)[1],
            "renewals_waiting": self.state.trust.identities.waiting(self.state.now()),
            "foreign_connections": sum(stream.peer.is_foreign for stream in self.state.streams),
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
        await self._gateways.close()
        await self._effects.updates.close()
        if self._server is not None:
            await self._server.close()
        for file in (self.state.parameter_file, self.state.deposit_file):
            if file is not None:
                file.close()

    async def _handle(self, stream: SecureStream[Identity]) -> None:
        state, name = self.state, shown(stream.peer.name)
        if not self._admission.has_room_for(stream.peer):
            _denials.warning("%s has too many connections", name)
            stream.abort("too many connections of one identity")
            return
        try:
            state.trust.admit(stream.peer, state.now())
        except HintedError as error:
            if stream.peer.is_foreign:  # its own master tells it what is revoked
                _denials.warning("%s is refused: %s", name, printable(error))
                stream.abort(str(error))
                return
            _denials.warning("%s is sent only the revocation list: %s", name, printable(error))
            await self._serve_revoked(stream)
            return
        state.streams.add(stream)  # until its socket is closed: a lingering one counts
        stream.when_closed(partial(state.streams.discard, stream))
        dispatch = partial(self._answers.dispatch, is_near(stream.address, stream.local_address))
        if self._admission.has_rights(stream.peer):
            stream.raise_unit_limit()
        else:
            dispatch = partial(self._admission.dispatch_unshown, stream, dispatch)
        await serve_calls(
            stream,
            dispatch,
            limit=self._limits.body,
            request_deadline=self._limits.request_seconds,
            idle_deadline=self._limits.idle_seconds,
            bound=partial(self._admission.body_bound, stream.peer),
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
                    answer = RevokedCalls(self.state.trust, self.state.now).answer
                    await serve_calls(stream, answer, limit=self._limits.body)
        finally:
            stream.abort("the identity is revoked")
            self._revoked_connections.release(keys)
