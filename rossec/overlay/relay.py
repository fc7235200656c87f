"""The relay of a site: what its parts are, and who of them knows whom. A shell.

Doors lead connections of this site into the link to their peer; links that peers make lead to what
the masters of this site show. Masters say which doors there are. A peer is cut when its card is
removed here, its domain is trusted no more, or its identity is revoked.
"""

import asyncio
import logging
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any, Final, Protocol, TypeAlias

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.domains.lists import ForeignDomain
from ca.errors import HintedError
from ca.names import RELAY, is_master_name
from ca.patterns import covers
from rossec.errors import ChannelError, OverlayUnavailable, RelayRefused, StreamRefused
from rossec.master.state.doors import Way
from rossec.net import withheld_log
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.overlay.door_table import DoorTable
from rossec.overlay.doors import Door
from rossec.overlay.link_transport import idle_round_trip
from rossec.overlay.mailboxes import mailbox
from rossec.overlay.masters import OwnMasters
from rossec.overlay.member import RelayMember
from rossec.overlay.mux import Role
from rossec.overlay.mux_units import Target
from rossec.overlay.peer_link import LinkState, PeerLink
from rossec.overlay.peers import Peer, Peers
from rossec.overlay.pump import Pump
from rossec.overlay.streams import Dial, Streams
from rossec.overlay.targets import Peer as RemoteRelay
from rossec.overlay.targets import Targets
from rossec.overlay.topic_ports import TopicPorts
from rossec.ros.text import printable
from rossec.sidecar.loopback_port import Admission

MAX_CALLED: Final = 2  # links that one peer has made: a new one, and one that it may have given up
_PERIOD: Final = 1.0
_log = logging.getLogger("rossec.overlay")
_audit = logging.getLogger("rossec.audit")
_Serve: TypeAlias = Callable[[SecureStream[Identity]], Awaitable[None]]


class Closable(Protocol):
    """What reads a mailbox."""

    async def close(self) -> None:
        """Read it no more."""


class LinkNetwork(Protocol):
    """The routers, as a relay uses them: see `rossec.overlay.network`."""

    @property
    def router(self) -> str:
        """The router in use; empty: none."""

    @property
    def seat(self) -> str:
        """The seat there."""

    async def dial(self, mailbox: str) -> SecureStream[Identity]:
        """A link to whoever reads this mailbox. Raises a `RossecError` or `TimeoutError`."""

    def listen(self, mailbox: str, serve: _Serve, label: str) -> Closable:
        """Call `serve` with each authenticated link that arrives in the mailbox of a peer."""


class Relay:
    """One relay, from `run` to its end.

    Args:
        member: its identity.
        network: the routers.
        admission: where doors are, and who may use them.
        read_peers: the peers as of now.
    """

    def __init__(
        self,
        member: RelayMember,
        network: LinkNetwork,
        admission: Admission,
        read_peers: Callable[[], Peers],
    ) -> None:
        self._member = member
        self._network = network
        self._read_peers = read_peers
        self._peers: dict[str, Peer] = {}
        self._links: dict[str, PeerLink] = {}
        self._mailboxes: dict[str, Closable] = {}
        self._called: dict[str, list[tuple[SecureStream[Identity], Streams]]] = {}
        self._table: Final = DoorTable(admission, self._carry, self.ways)
        self._masters = OwnMasters(member, secrets.token_hex(16), self._table)
        ports = TopicPorts(member.context, member.name, member.access.check_peer)
        self._targets = Targets(self._masters.target, ports)
        self._tasks = TaskSet(self._crashed)
        self._failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._problem = ""

    async def run(self) -> None:
        """Relay until cancelled.

        Raises:
            BaseException: what a part of it crashed with; every link is cut.
        """
        self._member.start()
        await self._take_peers()
        self._masters.start()
        try:
            await asyncio.gather(
                self._maintain(), self._member.wait_ended(), self._masters.wait_failed(),
                asyncio.shield(self._failure),
            )  # fmt: skip
        finally:
            await self._close()

    async def _close(self) -> None:
        await self._masters.close()
        await self._table.close()
        for label in tuple(self._peers):
            await self._drop(label)
        await self._tasks.close()
        await self._member.close()
        self._failure.cancel()

    def _crashed(self, error: BaseException) -> None:
        if not self._failure.done():
            self._failure.set_exception(error)

    async def _maintain(self) -> None:
        router = self._network.router
        while True:
            await asyncio.sleep(_PERIOD)
            router = self._note_router(router)
            await self._take_peers()
            for link in self._links.values():
                link.tick()

    def _note_router(self, before: str) -> str:
        """Say when another router is in use than before, or none; returns which."""
        router = self._network.router
        if router and router != before:
            _log.warning("router %s is in use now", router)
        elif router != before:
            _log.warning("no router takes the seat %s any more; links wait", self._network.seat)
        return router

    # -- peers

    async def _take_peers(self) -> None:
        """Take the peers as they are now; a file that is damaged changes nothing."""
        try:
            found = {label: each for label, each in self._read_peers().items() if each.is_complete}
            self._problem = ""
        except HintedError as error:
            if self._problem != str(error):
                _log.warning("%s (%s)", error, error.hint)
            self._problem = str(error)
            return
        for label in [label for label, peer in self._peers.items() if found.get(label) != peer]:
            await self._drop(label)
        for label in found.keys() - self._peers.keys():
            self._add(found[label])

    def _add(self, peer: Peer) -> None:
        key = mailbox(self._network.seat, bytes.fromhex(peer.box))
        try:
            serve = partial(self._serve, peer)
            self._mailboxes[peer.label] = self._network.listen(key, serve, peer.label)
        except OverlayUnavailable as error:  # tried again in a second
            _log.warning("%s: %s", peer.label, error)
            return
        self._peers[peer.label] = peer
        self._links[peer.label] = PeerLink(peer, self._dial)

    async def _drop(self, label: str) -> None:
        """A peer is gone, or its card is another one."""
        del self._peers[label]
        _audit.info("no links with %s any more", label)
        self._table.drop_peer(label)
        await self._mailboxes.pop(label).close()
        await self._links.pop(label).close()
        for stream, _ in self._called.pop(label, []):
            stream.abort("the peer is removed")

    def ways(self) -> Mapping[str, Way]:
        """How each peer is reached, by its label: what the masters show to people."""
        return {label: self._way(link) for label, link in self._links.items()}

    def _way(self, link: PeerLink) -> Way:
        called = self._called.get(link.peer.label, [])
        streams = [link.stream, *(stream for stream, _ in reversed(called))]
        found = next((stream for stream in streams if stream is not None), None)
        rtt, repeated = (0.0, 0) if found is None else measured(found)
        carried = link.carried + sum(len(each) for _, each in called)
        is_idle = link.state is LinkState.IDLE
        state = LinkState.LINKED if is_idle and called else link.state
        return Way(state.value, rtt, repeated, self._network.router, carried)

    # -- links

    async def _carry(self, door: Door, sock: socket.socket) -> None:
        """Carry what came in at a door. Owns `sock`."""
        link = self._links.get(door.peer)
        if link is None:
            sock.close()
            raise RelayRefused(f"no relay is called {door.peer} any more")
        await link.carry(door.target, sock)

    async def _dial(self, peer: Peer) -> SecureStream[Identity]:
        """A link to `peer`; raises as `DialPeer`."""
        self._check_admitted(peer)
        stream = await self._network.dial(peer.mailbox)
        self._admit(peer, stream)
        return stream

    def _check_admitted(self, peer: Peer) -> None:
        """Say before the handshake what would be less clear after it."""
        if not peer.domain:
            return
        listed = self._member.standing.anchors.listed(peer.domain)
        if listed is None:
            raise RelayRefused(
                f"no trusted domain is called {peer.domain}",
                "at this side's authority: rossec domain accept CARD",
            )
        if not any(covers(pattern, peer.relay) for pattern in listed.entry.admitted):
            raise RelayRefused(
                f"{peer.shown} is not admitted: the domain was accepted before relays were",
                "at this side's authority: rossec domain limit"
                f" {peer.domain} {_admit(listed.entry)}",
            )

    def _admit(self, peer: Peer, stream: SecureStream[Identity]) -> None:
        try:
            peer.check(stream.peer)
            self._member.admit(stream)
        except BaseException as error:
            stream.abort(str(error))
            raise

    async def _serve(self, peer: Peer, stream: SecureStream[Identity]) -> None:
        """Carry what the link of a peer brings, until it ends."""
        try:
            self._admit(peer, stream)
        except HintedError as error:
            where = f"the mailbox for {peer.label}"
            withheld_log.warn(_audit, withheld_log.REFUSED, where, shown(stream.peer.name), error)
            return
        remote = RemoteRelay(peer.label, peer.domain or "", peer.name)
        dial = partial(self._connect, stream.peer, self._targets.dial_for(remote))
        round_trip = partial(idle_round_trip, stream)
        streams = Streams(stream, Role.CALLED, peer.label, dial, round_trip=round_trip)
        entry = stream, streams
        called = self._called.setdefault(peer.label, [])
        called.append(entry)
        for older, _ in called[:-MAX_CALLED]:
            older.abort("the peer has made other links")
        _log.info("link from %s", peer.label)
        try:
            await streams.run()
        except (ChannelError, StreamRefused) as error:
            _log.info("the link from %s ended: %s", peer.label, printable(error))
        finally:
            called.remove(entry)

    async def _connect(
        self, found: Identity, dial: Dial, target: Target, pump: Pump
    ) -> socket.socket:
        self._member.check_target(found, target.kind)
        return await dial(target, pump)

    # -- for people

    def status(self) -> dict[str, Any]:
        """The relay for people and programs."""
        return {
            "relay": self._member.name,
            "domain": self._member.identity.domain,
            "seat": self._network.seat,
            "router": self._network.router,
            "masters": self._masters.status(),
            "peers": [self._peer_status(label) for label in sorted(self._links)],
            "doors": len(self._table),
            "problem": self._problem,
        }

    def _peer_status(self, label: str) -> dict[str, Any]:
        link = self._links[label]
        called = self._called.get(label, [])
        return {
            "label": label, "relay": link.peer.shown, **self._way(link)._asdict(),
            "called": len(called), "error": link.error, "hint": link.hint,
        }  # fmt: skip


def _admit(entry: ForeignDomain) -> str:
    """The options that admit whom the list admits, and so its relays too, but nobody else."""
    nodes = [each for each in entry.admitted if not is_master_name(each.replace("*", "x"))]
    return " ".join(f"--admit '{each}'" for each in nodes or [RELAY])


def measured(stream: SecureStream[Identity]) -> tuple[float, int]:
    """Round trip in milliseconds, and retransmissions of a link."""
    link = getattr(stream.transport, "link", None)
    if link is None:  # it has ended, or is none of the overlay
        return 0.0, 0
    return round(link.stats.srtt_s * 1000, 1), link.stats.retransmissions
