"""The running master: accepts secure connections, dispatches calls, sends answers. A shell.

Decisions are elsewhere: access control authorizes calls, `TrustState` tells which grants are valid,
the registry returns events. All state is used in one event loop, and a call is answered without
waiting for any peer, so no locks are needed. The effects of events are in `effects`, periodic work
in `maintenance`, connections to nodes in `updates`.
"""

import asyncio
import contextlib
import logging
import os
import secrets
import socket
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Final

from ca import svid
from ca.certificates import Identity, TrustAnchor
from ca.errors import HintedError, RevocationRefused
from ca.names import shown
from ca.revocation.lists import is_tree
from ca.revocation.trust_status import Revocations
from rossec.channel.edhoc.credentials import KnownCertificates, OwnCredential
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.channel.records import ChannelLimits
from rossec.home import NodeHome
from rossec.host.addresses import is_near
from rossec.master.api.dispatch import CONNECTION_SECONDS, MasterApi, RevokedCalls, RevokedConnections
from rossec.master.api.methods import StopMaster, TurnClock
from rossec.master.operation import DENIALS, MasterLimits
from rossec.master.rights import domain_trust, held_grants, renewals, statements
from rossec.master.server import maintenance
from rossec.master.server.answers import Admission, CallAnswers
from rossec.master.server.effects import Effects, MasterState, OnDenial, ignore_denial
from rossec.master.server.saved_state import DepositFile, ListFile, ParameterFile
from rossec.master.state import imported_facts, imports, parameters
from rossec.master.state.registry import Kind, Registry
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.net.limits import UNSHOWN_UNIT, HalfOpenCount, HalfOpenLimits
from rossec.net.rpc import serve_calls
from rossec.peer_limits import printable
from rossec.ros.http import HEADERS_LIMIT
from rossec.ros.names import is_loopback
from rossec.saved_statements import DomainFiles, saved_revocations

TIMESTAMP_EVERY: Final = 10.0  # seconds; a timestamp is valid for 30
_LIMITS: Final = MasterLimits()
PEER_CONNECTIONS: Final = _LIMITS.connections_per_identity

_denials = logging.getLogger(DENIALS)


class MasterServer:
    """The master; not a context manager: `start`, then `stopped` or `close`."""

    # It listens at `host` (None: all), and nodes are sent `advertise` as its host; `check_own_identity` is
    # called with the time in each round of maintenance, in which `nearby` is read too.
    def __init__(
        self,
        state: MasterState,
        credentials: OwnCredential,
        *,
        host: str | None = None,
        port: int = 11311,
        advertise: str = "localhost",
        suites: tuple[int, ...] = OFFERED_SUITES,
        timestamp_every: float = TIMESTAMP_EVERY,
        check_own_identity: Callable[[int], None] = lambda _: None,
        nearby: maintenance.LocalAuthority | None = None,
        turns: TurnClock | None = None,
    ) -> None:
        self._address = (host, port)
        self._advertise = advertise
        self._turns = TurnClock(time.monotonic) if turns is None else turns
        self.state, limits = state, state.limits
        dialled = ChannelLimits(unit=limits.body + HEADERS_LIMIT, handshake_seconds=limits.handshake_seconds)
        # Little is taken until grants are known: a certificate costs a foreign authority nothing.
        unshown = replace(dialled, preauth_limit=min(dialled.unit, UNSHOWN_UNIT))
        self.context: Final = SecureContext(
            credentials,
            state.trust.domains.anchors.verify,
            suites=suites,
            known=KnownCertificates(),
            dial_limits={WireProtocol.HTTP: dialled},
            accept_limits={WireProtocol.HTTP: unshown},
            half_open=HalfOpenCount(HalfOpenLimits(limits.unfinished_per_address, limits.unfinished)),
            renews=Identity.renews,
        )
        self.effects: Final = Effects(state, self.context)
        nearby = (
            maintenance.LocalAuthority(maintenance.no_authority, state.trust) if nearby is None else nearby
        )
        self._maintenance = maintenance.Maintenance(
            state, self.effects, timestamp_every, check_own_identity, nearby
        )
        self._gateways = maintenance.Gateways(state, self.effects)
        self._admission = Admission(state)
        self._revoked_connections = RevokedConnections()
        self._api: MasterApi  # set by `start`, as it has the port
        self._answers: CallAnswers  # likewise, before a connection is handled
        self._server: SecureServer[Identity] | None = None

    @property
    def port(self) -> int:
        return self._address[1] if self._server is None else self._server.port

    @property
    def uri(self) -> str:
        host = f"[{self._advertise}]" if ":" in self._advertise else self._advertise
        return f"http://{host}:{self.port}/"

    async def start(self) -> None:
        state = self.state
        self._server = serve(self._handle, *self._address, self.context, WireProtocol.HTTP)
        if state.parameter_file is not None:
            state.parameter_file.open()
        if state.deposit_file is not None:
            state.deposit_file.open()
            self.effects.drop_deposits()
        self._api = MasterApi(
            state,
            uri=self.uri,
            pid=os.getpid(),
            instance=secrets.token_hex(8),
            started=state.now(),
            connected=lambda: [stream.peer for stream in state.streams],
        )
        self._answers = CallAnswers(self._api, state, self.effects, self._turns)
        self._maintenance.start(self._api.keep_views)
        self._gateways.start()

    def mirror(self, site: imported_facts.Site, tree: dict[str, object]) -> None:
        self._send_mirrored(self.state.imports.mirrors.replace(site, tree))

    def drop_mirror(self, label: str) -> None:
        self._send_mirrored(self.state.imports.mirrors.drop(label))

    def _send_mirrored(self, changes: Iterable[parameters.MirrorChange]) -> None:
        for event in self._api.parameters.mirror(changes, self.state.now()):
            self.effects.deliver(event)

    def status(self) -> dict[str, str | int]:
        registry = self.state.registry
        entries = [entry for kind in Kind for entry in registry.entries(kind)]
        own = svid.parse(self.context.credentials.current.certificate)
        return {
            "uri": self.uri,
            "pid": os.getpid(),
            "calls": self.effects.calls,
            "denials": self.effects.denials,
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
        self.effects.deliver(StopMaster(reason))

    async def stopped(self) -> None:
        await self.effects.stopping.wait()

    async def close(self) -> None:
        await self._maintenance.close()
        await self._gateways.close()
        await self.effects.updates.close()
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
            limit=state.limits.body,
            request_deadline=state.limits.request_seconds,
            idle_deadline=state.limits.idle_seconds,
            bound=partial(self._admission.body_bound, stream.peer),
        )

    async def _serve_revoked(self, stream: SecureStream[Identity]) -> None:
        # Answer for a few seconds; not one of the streams, so it is sent no updates.
        keys = stream.peer.keys
        if not self._revoked_connections.admit(keys):
            stream.abort("too many connections of a revoked identity")
            return
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CONNECTION_SECONDS):
                    answer = RevokedCalls(self.state.trust, self.state.now).answer
                    await serve_calls(stream, answer, limit=self.state.limits.body)
        finally:
            stream.abort("the identity is revoked")
            self._revoked_connections.release(keys)


_log = logging.getLogger("rossec.master.start")


def master_of(
    home: NodeHome,
    *,
    host: str | None,
    port: int,
    newest: bytes | None,
    now: int,
    entries: bytes | None = None,
    renewer: renewals.Renewer | None = None,
    on_denial: OnDenial = ignore_denial,
    limits: MasterLimits = _LIMITS,
    suites: tuple[int, ...] = OFFERED_SUITES,
    find_revocations: maintenance.FindRevocations = maintenance.no_authority,
    find_domains: maintenance.FindDomains = maintenance.no_domains,
) -> MasterServer:
    """The master whose identity is in `home`, not yet started.

    `host` (ROS_HOSTNAME or ROS_IP) is advertised, and listened on alone when it is loopback, as in ROS; None:
    this machine's name, and any address. `newest` is a revocation list (of a tree, with its `entries`) that
    may be newer than the one saved, from an authority on this host. `renewer` renews identities with an
    intermediate of this host; None: the authority's service does.
    """
    anchor, own_identity, saved_list = home.anchor(), maintenance.OwnIdentity(home, now), ListFile(home)
    signer = own_identity.credentials.current.signer
    # 1. The newest revocation list known here.
    revocations = saved_revocations(home, anchor, now)
    if newest is not None:
        revocations.update(newest, now, saved_list.save)
    # 2. The authority's leave to renew grants; without it nodes ask the authority.
    delegate = renewals.TicketSigner(anchor, signer, home.save_delegation)
    delegation = home.load_delegation()
    if delegation is not None:
        try:
            delegate.take(delegation)
        except HintedError as error:
            _log.warning("grants are not renewed: %s", error)
    # 3. All that is trusted, and the entries of a tree, in which only its root is signed.
    trust = statements.TrustState(
        anchor,
        signer,
        revocations,
        saved_list.save,
        delegate,
        saved_list.save_entries,
        renewer,
        _domains(home, anchor, revocations, saved_list, now),
    )
    if is_tree(revocations.data):
        for found in (entries, home.load_entries()):
            if found is not None:
                with contextlib.suppress(RevocationRefused):
                    trust.update_tree(revocations.data, found, now)
                    break
        else:
            _log.warning("the entries of the revocation tree are missing: rossec ca publish")
    # 4. The master is a node of its own site: its identity is renewed as theirs are.
    own_key = home.identity(now).thumbprint
    own_identity.renew = lambda request, at: trust.identities.ask(own_key, request, at, trust.check)

    def maintain(now: int) -> None:
        own_identity.check(now)
        saved_list.retry()

    state = MasterState(
        name=home.name,
        trust=trust,
        imports=imports.Imports(Registry(limits.nodes_per_identity)),
        limits=limits,
        on_denial=on_denial,
        parameter_file=ParameterFile(home.path / "parameters.journal"),
        deposit_file=DepositFile(home.path / "deposits.journal", held_grants.verifier(anchor, trust.check)),
    )
    server = MasterServer(
        state,
        own_identity.credentials,
        host=host if host is not None and is_loopback(host) else None,
        port=port,
        advertise=host or socket.gethostname(),
        suites=suites,
        check_own_identity=maintain,
        nearby=maintenance.LocalAuthority(find_revocations, trust, find_domains),
    )

    def answered(key: bytes) -> None:
        if key == own_key:
            server.effects.list_changed.set()

    trust.identities.on_answered = answered
    return server


def _domains(
    home: NodeHome, anchor: TrustAnchor, own: Revocations, saved_list: ListFile, now: int
) -> domain_trust.DomainTrust:
    saved = DomainFiles(home, anchor)
    trust_status = saved.trust_status(saved.anchors(), own, now)

    def load_foreign(domain: str) -> bytes | None:
        try:
            return saved.load_foreign(domain)
        except (HintedError, OSError) as error:
            _log.warning("the saved revocations of %s: %s", domain, printable(error))
            return None

    def save_foreign(domain: str, data: bytes) -> None:
        listed = trust_status.anchors.listed_domain(domain)
        if listed is not None:
            saved_list.save_by(("of", domain), partial(saved.save_foreign, listed.anchor), data)

    save = partial(saved_list.save_by, "domains", saved.save_domains)
    return domain_trust.DomainTrust(trust_status, save, save_foreign, load_foreign)
