"""The masters of a relay's site, and the relay as a node of its own domain. A shell.

The own master names the others, which follow each other in a mesh; each says which forwarded ports it
wants, and where targets that are registered at it are. It is polled, so it needs no address of the relay.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping
from functools import partial
from secrets import SystemRandom
from typing import Final, NamedTuple

from ca.certificates import Identity
from ca.errors import HintedError, NameRefused, RevocationsStale
from ca.names import check_label, check_name, is_master_name, shown
from ca.revocation.trust_status import TrustStatus
from rossec import clock, environment, errors, peer_limits
from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.channel.opening import post_quantum
from rossec.errors import AnswerMalformed
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.master.state.forwarded_ports import AT_ONCE, KINDS, MAX_FORWARDED_PORTS, ForwardedPort, Target
from rossec.master.state.registry import is_connectable
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.net.rpc import CallFailed, RpcClient
from rossec.overlay import mux
from rossec.overlay.forwarded_ports import ForwardedPortTable
from rossec.participant import access, connections, membership, registrations
from rossec.ros import names, xmlrpc
from rossec.ros.names import RELAY_FORWARDED_PORTS, RELAY_TARGET, Settings, build_forwarded_port, parse_uri

REPORTED_AT_ONCE: Final = AT_ONCE // 2  # a call is limited in size, and has all ways too
_MAX_MASTERS: Final = 64


class Orders(NamedTuple):
    """What an answer asks for."""

    open: tuple[Target, ...]
    close: tuple[Target, ...]
    masters: Mapping[str, str]  # names and URIs of others of the own domain, to be polled too


class WantedPorts:
    # What one master wants: which ports are open for it, and what to tell it next. Pure. On a new connection
    # everything is wanted and told anew, as the master may have been started again. What it then does not
    # want any more is closed when it has told all: an answer without news.

    def __init__(self) -> None:
        self.seen = 0
        self._held: dict[Target, ForwardedPort] = {}
        self._untold: dict[Target, ForwardedPort] = {}
        self._failed: dict[Target, None] = {}
        self._old: set[Target] = set()  # held before this connection, and not wanted anew so far

    @property
    def held(self) -> tuple[Target, ...]:
        return tuple(self._held)

    def connected(self) -> None:
        self.seen = 0
        self._untold.clear()
        self._failed.clear()
        self._old = set(self._held)

    def report(self) -> list[list[object]]:
        told = list(self._untold.items())[:REPORTED_AT_ONCE]
        return [[*target, *forwarded_port] for target, forwarded_port in told]

    def take(self, answer: object, reported: int) -> Orders:
        match answer:
            case {
                "version": int() as version,
                "wanted": list() as wanted,
                "unwanted": list() as unwanted,
                "masters": dict() as masters,
                **rest,
            } if not rest:
                pass
            case _:
                raise AnswerMalformed("a master's answer about forwarded ports that is malformed")
        new, gone = [*map(_target, wanted)], [*map(_target, unwanted)]
        others = _masters(masters)
        if len(self._held.keys() | set(new)) > MAX_FORWARDED_PORTS:
            raise AnswerMalformed(f"a master that wants more than {MAX_FORWARDED_PORTS} forwarded ports")
        self.seen = version
        for target in list(self._untold)[:reported]:
            del self._untold[target]
        self._old.difference_update(new)
        if not new and not gone:
            gone, self._old = [*self._old], set()
        for target in gone:
            self._untold.pop(target, None)
            self._failed.pop(target, None)
            self._old.discard(target)
        closed = tuple(target for target in gone if self._held.pop(target, None) is not None)
        return Orders(tuple(dict.fromkeys((*new, *self._failed))), closed, others)

    def opened(self, target: Target, forwarded_port: ForwardedPort) -> None:
        self._held[target] = self._untold[target] = forwarded_port
        self._failed.pop(target, None)

    def failed(self, target: Target) -> bool:
        is_new = target not in self._failed
        self._failed[target] = None
        return is_new

    def lost(self, targets: Iterable[Target]) -> list[Target]:
        found = [target for target in targets if self._held.pop(target, None) is not None]
        for target in found:
            self._untold.pop(target, None)
        return found


def _target(value: object) -> Target:
    match value:
        case [str() as peer, str() as kind, str() as name] if kind in KINDS:
            try:
                return Target(check_label(peer), kind, check_name(name))
            except NameRefused as error:
                raise AnswerMalformed(f"a master that wants a forwarded port of no target: {error}") from None
        case _:
            raise AnswerMalformed("a master that wants a forwarded port of no target")


def _masters(found: Mapping[object, object]) -> dict[str, str]:
    if len(found) > _MAX_MASTERS:
        raise AnswerMalformed("a master's answer with too many masters")
    masters = {
        name: uri
        for name, uri in found.items()
        if isinstance(name, str) and isinstance(uri, str)
        if is_master_name(name) and is_connectable(uri, "http")
    }
    if len(masters) != len(found):
        raise AnswerMalformed("a master's answer with a master that is not one")
    return masters


_log = logging.getLogger("rossec.overlay")
OLD_MASTER: Final = 30.0  # seconds until a master that knows no relays is asked again
_Failures: Final = (HintedError, OSError, TimeoutError)
Dial = Callable[[], Awaitable[SecureStream[Identity]]]
"""Connects with the master as the relay, for HTTP; who answers is checked here."""


class RelayMember:
    """The identity of the relay that is certified as `name`, kept current at its own master.

    As every form of a node it keeps a session with its master, so that lists and a renewed certificate
    arrive. Every link is in its table of connections, which cuts it.
    """

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        self.settings: Final[Settings] = names.read((), environ, default_name=name)
        home = NodeHome.of(environment.own_home(environ), name)
        loaded = membership.LoadedIdentity(home, name, environment.own_master(environ))
        self.home: Final = home
        self.name: Final = name
        self.master: Final = loaded.master
        self.identity: Final = loaded.identity
        self.trust_status: Final[TrustStatus] = loaded.trust_status
        self.access: Final = access.Access(loaded.trust_status, master=loaded.master)
        suites = post_quantum(environ)
        verify = loaded.anchors.verify
        self.context: Final = SecureContext(
            loaded.live_credentials, verify, suites=suites, known=KnownCertificates(), renews=Identity.renews
        )
        self.link_context: Final = SecureContext(  # certificates by value, as links are made rarely
            loaded.live_credentials, verify, suites=suites, renews=Identity.renews
        )
        self._connections: connections.ConnectionTable[SecureStream[Identity]] = connections.ConnectionTable(
            loaded.trust_status, master=loaded.master
        )
        self._links: set[SecureStream[Identity]] = set()
        self._failed = False
        self._dialer = connections.Dialer(name, self.context, self.access.check_peer)
        grace = registrations.PublisherGrace(clock.counter())
        self._membership = membership.Membership(loaded, self.access, self._connections, grace, self)
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def start(self) -> None:
        self._membership.start()

    async def wait_ended(self) -> None:
        """Wait until it ends by itself."""
        await asyncio.shield(self._ended)

    async def close(self) -> None:
        """End the session and every link."""
        self._abort_links("the relay ends")
        await self._membership.close()
        self._ended.cancel()

    async def refresh(self) -> None:
        """Ask the master now for lists that are new, and cut what they end."""
        # It has no slave API: the master's answer to a call that waits is the sign that lists may have
        # changed.
        try:
            await self._membership.session.refresh()
        except (HintedError, OSError, TimeoutError, xmlrpc.Fault) as error:
            # Asked again with the next heartbeat.
            _log.debug("%s: no lists from the master: %s", self.name, error)

    def admit(self, link: SecureStream[Identity]) -> None:
        """Count a link with an authenticated relay until it is closed; it is cut when it must end."""
        self._connections.accept(link, link.peer)  # a list may arrive meanwhile
        self._links.add(link)
        link.when_closed(partial(self._forget, link))
        if self._failed:
            raise errors.ChannelClosed("the relay has failed")
        try:
            self.check_peer(link.peer)
        except RevocationsStale:
            # A foreign relay may come while its domain's revocations are stale, or the masters of two domains
            # could never tell each other (`check_target` says for what); never while the own list is.
            if not link.peer.is_foreign:
                raise
            for key in link.peer.keys:
                self.trust_status.own.check(key, clock.now())

    def check_target(self, peer: Identity, kind: str) -> None:
        """Return if a link with `peer` may lead to a target of this kind now."""
        try:
            self.check_peer(peer)
        except RevocationsStale:
            if kind != mux.MASTER or not peer.is_foreign:
                raise

    def _forget(self, link: SecureStream[Identity]) -> None:
        self._connections.forget(link)
        self._links.discard(link)

    def check_peer(self, peer: Identity) -> None:
        """Raise a `CAError` when `peer` is revoked, or this is not known."""
        self.access.check_peer(peer, clock.now())

    @property
    def is_connected(self) -> bool:
        return self._membership.session.is_open

    def _abort_links(self, reason: str) -> None:
        for link in tuple(self._links):
            link.abort(reason)

    # -- hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        return await self._dialer.rpc(self.settings.master_host, self.settings.master_port)

    async def dial_watch(self) -> SecureStream[Identity]:
        return await self.dial_master()

    async def restore(self) -> None:
        """Nothing is registered."""

    async def rights_changed(self) -> None:
        """No registration waits for a right."""

    def maintain(self) -> None:
        """Nothing is due each second: a link ends by itself with the certificate of its peer."""

    def crashed(self, error: BaseException) -> None:
        """Cut every link, and admit none: nothing would cut it."""
        self._failed = True
        self._abort_links("the relay has failed")
        if not self._ended.done():
            self._ended.set_exception(error)


class MasterLink:
    """One master of the own domain.

    Args:
        name: the name it is certified for.
        relay: the relay's own name.
        instance: random, of this run of the relay.
        on_masters: called with the masters that this one says shall be polled too.
    """

    def __init__(
        self,
        name: str,
        relay: str,
        instance: str,
        dial: Dial,
        forwarded_ports: ForwardedPortTable,
        on_masters: Callable[[Mapping[str, str]], None],
    ) -> None:
        self.name: Final = name
        self.error = ""  # why the master is not polled now; empty: it is
        self._relay, self._instance, self._dial = relay, instance, dial
        self._forwarded_ports, self._on_masters = forwarded_ports, on_masters
        self._wanted = WantedPorts()
        self._asking: RpcClient | None = None
        self._turn = asyncio.Lock()
        self._retry = registrations.Retry(SystemRandom().random)

    async def run(self) -> None:
        try:
            while True:
                pause = await self._poll_until_failure()
                await asyncio.sleep(pause)
        finally:
            for target in self._wanted.held:
                self._forwarded_ports.release(target, self.name)

    async def close(self) -> None:
        async with self._turn:
            if self._asking is not None:
                await self._asking.close()

    async def target(self, domain: str, kind: str, name: str) -> tuple[str, int]:
        try:
            answer = await self._ask(domain, kind, name)
        except (errors.AnswerRefused, xmlrpc.Fault) as error:
            text = error.faultString if isinstance(error, xmlrpc.Fault) else error
            raise errors.StreamRefused(peer_limits.printable(f"{self.name}: {text}")) from error
        match answer:
            case [str() as host, int() as port] if is_connectable(build_forwarded_port(host, port), "http"):
                return host, port
            case _:
                raise errors.AnswerMalformed(f"{self.name} says that a target is nowhere")

    async def _ask(self, domain: str, kind: str, name: str) -> object:
        for _ in range(2):  # the master ends a connection that was silent for long
            kept = self._asking
            async with self._turn:
                if self._asking is None or self._asking.closed:
                    self._asking = RpcClient(await self._connected())
                client = self._asking
            try:
                return await client.ask(RELAY_TARGET, self._relay, domain, kind, name)
            except errors.RossecError:
                if client is not kept or not client.closed:
                    raise
        raise CallFailed(f"{self.name} ends every connection")

    async def _connected(self) -> SecureStream[Identity]:
        stream = await self._dial()
        peer = stream.peer
        # A master answers for its site: a node with an anonymous name, or another domain's, must not.
        if peer.is_foreign or peer.wildcard or peer.name != self.name:
            stream.abort("not the master of this relay")
            raise errors.RelayRefused(
                f"{shown(peer.name)} answers at the address of {self.name}",
                "check ROS_MASTER_URI, and the URIs in: rossec federation list",
            )
        return stream

    async def _poll_until_failure(self) -> float:
        try:
            client = RpcClient(await self._connected())
            try:
                self._wanted.connected()
                while True:
                    report = self._wanted.report()
                    ways = {peer: way._asdict() for peer, way in self._forwarded_ports.ways().items()}
                    answer = await client.ask(
                        RELAY_FORWARDED_PORTS, self._relay, self._instance, self._wanted.seen, report, ways
                    )
                    orders = self._wanted.take(answer, len(report))
                    self._retry.succeeded()
                    self.error = ""
                    await self._carry_out(orders)
            finally:
                with contextlib.suppress(*_Failures):
                    await client.close()
        except xmlrpc.Fault as fault:
            self._report(f"it is older than this relay, update it: {fault.faultString}")
            return OLD_MASTER
        except _Failures as error:
            hint = error.hint if isinstance(error, HintedError) else ""
            self._report(f"{error} ({hint})" if hint else str(error) or type(error).__name__)
        return self._retry.pause(asyncio.get_running_loop().time())

    async def _carry_out(self, orders: Orders) -> None:
        for target in orders.close:
            self._forwarded_ports.release(target, self.name)
        again = self._wanted.lost(self._forwarded_ports.take_dropped(self.name))
        for target in (*orders.open, *again):
            try:
                self._wanted.opened(target, await self._forwarded_ports.open(target, self.name))
            except _Failures as error:
                if self._wanted.failed(target):
                    where = f"{target.name} of {target.peer}"
                    _log.warning("no forwarded port for %s: %s", where, peer_limits.printable(error))
        self._on_masters(orders.masters)

    def _report(self, text: str) -> None:
        text = peer_limits.printable(text)
        if text != self.error:
            _log.warning("%s: %s", self.name, text)
        self.error = text


class OwnMasters:
    """The links of a relay to masters of its own domain; `instance`: random, of this run of it."""

    def __init__(self, member: RelayMember, instance: str, forwarded_ports: ForwardedPortTable) -> None:
        self._member, self._instance, self._forwarded_ports = member, instance, forwarded_ports
        self._links: dict[str, MasterLink] = {}
        self._runs: dict[str, asyncio.Task[None]] = {}
        self._uris: dict[str, str] = {}
        self._lists_due = asyncio.Event()
        self._tasks = TaskSet(self._crashed)
        self._failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def start(self) -> None:
        member = self._member
        self._tasks.spawn(self._refresh(), "asking for lists")
        dial = member.dial_master
        self._begin(
            MasterLink(
                member.master, member.name, self._instance, dial, self._forwarded_ports, self._answered
            )
        )

    async def wait_failed(self) -> None:
        await asyncio.shield(self._failed)

    async def close(self) -> None:
        await self._tasks.close()
        for link in self._links.values():
            await link.close()
        self._failed.cancel()

    async def target(self, domain: str, kind: str, name: str) -> tuple[str, int]:
        if kind == mux.MASTER:
            links = [self._links[name]] if name in self._links else []
        else:
            links = list(self._links.values())
        refusal: HintedError = errors.RelayRefused(f"no {kind} {name} is shown there")
        for link in links:
            try:
                return await link.target(domain, kind, name)
            except HintedError as error:
                refusal = error
            except (OSError, TimeoutError) as error:
                refusal = errors.RelayRefused(f"{link.name} does not answer: {error}")
        raise refusal

    def status(self) -> dict[str, str]:
        return {name: link.error for name, link in self._links.items()}

    def _begin(self, link: MasterLink) -> None:
        self._links[link.name] = link
        self._runs[link.name] = self._tasks.spawn(link.run(), f"forwarded ports of {link.name}")

    async def _refresh(self) -> None:
        while True:
            await self._lists_due.wait()
            self._lists_due.clear()
            await self._member.refresh()

    def _crashed(self, error: BaseException) -> None:
        if not self._failed.done():
            self._failed.set_exception(error)

    def _answered(self, masters: Mapping[str, str]) -> None:
        self._lists_due.set()
        # Only the own master says which others there are; one with another URI is another one.
        own = self._member.master
        named = {name: uri for name, uri in masters.items() if name != own}
        for name in [name for name, uri in self._uris.items() if named.get(name) != uri]:
            del self._uris[name]
            self._runs.pop(name).cancel()
            self._tasks.spawn(self._links.pop(name).close(), f"leaving {name}")
        for name, uri in named.items():
            if name not in self._uris:
                self._uris[name] = uri
                dial = partial(self._dial, uri)
                link = MasterLink(
                    name,
                    self._member.name,
                    self._instance,
                    dial,
                    self._forwarded_ports,
                    lambda _masters: None,
                )
                self._begin(link)

    async def _dial(self, uri: str) -> SecureStream[Identity]:
        address = parse_uri(uri, "the master's URI")
        stream = await connect(*address, self._member.context, WireProtocol.HTTP)
        try:
            self._member.check_peer(stream.peer)
        except BaseException:
            stream.abort("the master's identity is revoked or cannot be checked")
            raise
        return stream
