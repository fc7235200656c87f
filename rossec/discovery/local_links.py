"""Announcing a master on every link of this host, and finding one there (IPv6, link-local). A shell.

The master announces its address periodically. A node listens, probes announced masters, and chooses
the one with the best link: a probe opens a TCP connection and closes it, which measures the round
trip and nothing else. With `ROS_MASTER_URI=discover:` the master is found when the program starts,
and does not change: a program cannot be moved to another master.
"""

import asyncio
import contextlib
import ipaddress
import logging
import secrets
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import suppress
from itertools import count, islice
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.errors import CAError
from ca.names import check_name
from rossec import clock, environment, peer_limits, saved_statements
from rossec.channel.edhoc.credentials import Credentials
from rossec.discovery import announcement
from rossec.errors import AnnouncementRefused, ConfigurationError, MasterNotFound
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.ros.names import is_loopback, parse_uri

GROUP: Final = "ff12::726f:7373:6563"  # transient, link-local scope (RFC 4291 section 2.7)
PORT: Final = 11311
_HOPS: Final = 255  # sent and required: a router would have lowered it (RFC 5082)
_MAX_DATAGRAM: Final = 2048
_ANCILLARY: Final = socket.CMSG_SPACE(struct.calcsize("i")) + socket.CMSG_SPACE(20)
PERIOD: Final = 0.5  # enough in four seconds to measure the loss
PATIENCE: Final = 10.0  # seconds; a master announces itself twice in each
SETTLE: Final = 4.0  # seconds after the first: time to receive others and to measure their loss
_PROBE: Final = 2.0
_LOOK: Final = 0.1
_AT_ONCE: Final = 32  # datagrams
_REJOIN: Final = 1.0
VARIABLE: Final = "ROS_MASTER_URI"
DISCOVER: Final = "discover:"
_log = logging.getLogger("rossec.master")


class MulticastSocket:
    def __init__(self, *, listen: bool, port: int = PORT) -> None:
        self._port = port
        self._socket = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.setblocking(False)
            level = socket.IPPROTO_IPV6
            self._socket.setsockopt(level, socket.IPV6_V6ONLY, 1)
            self._socket.setsockopt(level, socket.IPV6_MULTICAST_HOPS, _HOPS)
            self._socket.setsockopt(level, socket.IPV6_RECVHOPLIMIT, 1)
            if listen:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                self._socket.bind(("::", self._port))  # a group of this scope cannot be bound for all links
        except BaseException:
            self._socket.close()
            raise
        self._listens = listen
        self.join()

    def fileno(self) -> int:
        return self._socket.fileno()

    def join(self) -> None:
        # Join the group on links that are new; those that cannot multicast are left out.
        if not self._listens:
            return
        for index, _ in socket.if_nameindex():
            group = socket.inet_pton(socket.AF_INET6, GROUP) + struct.pack("@I", index)
            with suppress(OSError):  # joined already, or no such link any more
                self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group)

    def send(self, data: bytes) -> int:
        sent = 0
        # Once for each link: a group of link-local scope leaves by one alone (RFC 4291 section 2.7).
        for index, _ in socket.if_nameindex():
            with suppress(OSError):  # down, or without IPv6
                self._socket.sendto(data, (GROUP, self._port, 0, index))
                sent += 1
        return sent

    def receive(self) -> Iterator[tuple[bytes, announcement.DatagramSource]]:
        while True:
            try:
                data, ancillary, flags, where = self._socket.recvmsg(_MAX_DATAGRAM, _ANCILLARY)
            except OSError:  # nothing more, or a link that went down: retrying might never end
                return
            if not flags & socket.MSG_TRUNC and _is_local(where[0], ancillary):
                yield data, announcement.DatagramSource(where[0], where[3])

    def close(self) -> None:
        self._socket.close()


def _is_local(address: str, ancillary: list[tuple[int, int, bytes]]) -> bool:
    hops = [
        struct.unpack("i", value)[0]
        for level, kind, value in ancillary
        if (level, kind) == (socket.IPPROTO_IPV6, socket.IPV6_HOPLIMIT) and len(value) == 4
    ]
    # Only this link can have sent it: every router lowers the limit (RFC 5082).
    source = ipaddress.IPv6Address(address)
    return hops == [_HOPS] and (source.is_link_local or source.is_loopback)


async def announce(
    credentials: Credentials, uri: str, *, version: Callable[[], int] = lambda: 0, period: float = PERIOD
) -> None:
    """Announce the master at `uri` until cancelled; `version`: of its graph now, counts up."""
    host, port = parse_uri(uri, "the master's URI")
    if is_loopback(host):
        raise ConfigurationError(
            f"the master at {uri} cannot be announced: only this host reaches it",
            "set ROS_IP or ROS_HOSTNAME to an address of the network",
        )
    # New at every start: the sequence numbers begin again with it.
    instance = secrets.token_bytes(announcement.INSTANCE_SIZE)
    group = MulticastSocket(listen=False)
    was_sent = True
    try:
        for seq in count():
            now, hint = clock.now(), version() % (1 << 31)
            said = announcement.Announcement(host, port, instance, seq, now, version=hint)
            sent = group.send(announcement.sign(credentials.signer, credentials.chain, said)) > 0
            if sent is not was_sent:
                _log.warning("announcing on %s", "the links again" if sent else "no link: all down")
            was_sent = sent
            await asyncio.sleep(period)
    finally:
        group.close()


async def find(
    anchor: TrustAnchor,
    revoked: frozenset[bytes] = frozenset(),
    *,
    patience: float = PATIENCE,
    settle: float = SETTLE,
) -> list[announcement.Candidate]:
    candidates = announcement.Candidates(anchor, revoked)
    async with listening(candidates):
        end, found = time.monotonic() + patience, False
        while time.monotonic() < end:
            await asyncio.sleep(_LOOK)
            if not found and candidates.best(clock.now(), time.monotonic()) is not None:
                end, found = time.monotonic() + settle, True
    ranked = candidates.ranked(clock.now(), time.monotonic())
    if reached := [one for one in ranked if one.rtt is not None]:
        return reached
    if ranked:
        where = ", ".join(f"{host} port {port}" for host, port in ranked[0].endpoints)
        raise MasterNotFound(
            f"a master announces itself, but nothing answers at {peer_limits.printable(where)}",
            "is a firewall between? its TCP port must be open",
        )
    # The most frequent reason: what a stranger sends now and then does not hide it.
    if candidates.refused:
        why, times = candidates.refused.most_common(1)[0]
        raise MasterNotFound(
            f"no master of this trust domain was found, but {times} times: {peer_limits.printable(why)}",
            "set ROS_MASTER_URI to the master of this domain",
        )
    raise MasterNotFound(
        "no master announces itself on the links of this host",
        "start it with `rossec master --announce`, or set ROS_MASTER_URI",
    )


@contextlib.asynccontextmanager
async def listening(candidates: announcement.Candidates) -> AsyncIterator[None]:
    """Feed `candidates` with datagrams from all links, and probe each master."""
    group = MulticastSocket(listen=True)
    probes = TaskSet()

    def arrived() -> None:
        for data, source in islice(group.receive(), _AT_ONCE):  # the rest in the next turn of the loop
            with contextlib.suppress(AnnouncementRefused):
                heard = candidates.heard(data, source, clock.now(), time.monotonic())
                if heard is not None:
                    probes.spawn(_probe(candidates, heard))

    async def rejoin() -> None:
        while True:
            await asyncio.sleep(_REJOIN)
            group.join()

    loop = asyncio.get_running_loop()
    loop.add_reader(group.fileno(), arrived)
    probes.spawn(rejoin())
    try:
        yield
    finally:
        loop.remove_reader(group.fileno())
        await probes.close()
        group.close()


async def _probe(candidates: announcement.Candidates, candidate: announcement.Candidate) -> None:
    for host, port in candidate.endpoints:
        begun = time.monotonic()
        try:
            async with asyncio.timeout(_PROBE):
                _, writer = await asyncio.open_connection(host, port)
        except (OSError, TimeoutError, UnicodeError):
            continue
        candidates.probed(candidate, (host, port), time.monotonic() - begun)
        writer.close()
        return


async def discover_master(
    environ: Mapping[str, str], identity: str | NodeHome | None, settle: float = SETTLE
) -> dict[str, str]:
    """`environ`, with the URI of the best link to its master where discovery was asked for.

    `identity`: the node that will use it, or its directory, whose authority certifies the master;
    None: any node of this home, if all of them trust the same authority.
    """
    if environ.get(VARIABLE) != DISCOVER:
        return dict(environ)
    wanted = environment.own_master(environ)
    found = await masters(environment.own_home(environ), identity, settle=settle)
    best = next((one for one in found if one.name == wanted), None)
    if best is None:
        others = ", ".join(sorted({one.name for one in found}))
        raise MasterNotFound(
            f"{wanted} does not announce itself, but {others}",
            f"to work with another master set {environment.OWN_MASTER} to its name",
        )
    return {**environ, VARIABLE: uri_of(best)}


async def masters(
    home: Path, identity: str | NodeHome | None, patience: float = PATIENCE, settle: float = SETTLE
) -> list[announcement.Candidate]:
    """The masters that a node of this home would trust, the best link first."""
    anchor, revoked = trusted(home, identity)
    return await find(anchor, revoked, patience=patience, settle=settle)


def uri_of(candidate: announcement.Candidate) -> str:
    """Where a candidate was reached, as ROS_MASTER_URI has it."""
    host, port = candidate.endpoint or candidate.endpoints[0]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def trusted(home: Path, identity: str | NodeHome | None) -> tuple[TrustAnchor, frozenset[bytes]]:
    """The trust anchor of the nodes of this home, and what they know to be revoked."""
    match identity:
        case None:
            found = sorted((home / "nodes").glob("*/ca.pem"))
            nodes = [NodeHome(path.parent, "/" + path.parent.name.replace(".", "/")) for path in found]
        case str():
            nodes = [NodeHome.find(home, check_name(identity))]
        case _:
            nodes = [identity]
    # Two authorities here: whose master it is, only the person knows.
    anchors = {anchor.thumbprint: anchor for anchor in map(_anchor, nodes)}
    if not anchors:
        raise ConfigurationError(
            "no node is enrolled here, so no master can be trusted",
            "enroll one first: rossec node request NAME",
        )
    if len(anchors) > 1:
        raise ConfigurationError(
            "the nodes enrolled here trust different authorities",
            "name the one to find a master for, with --as NAME",
        )
    (anchor,) = anchors.values()
    saved = (saved_statements.saved_revocations(node, anchor, clock.now()).entries for node in nodes)
    return anchor, frozenset().union(*saved)


def _anchor(node: NodeHome) -> TrustAnchor:
    try:
        return node.anchor()
    except (CAError, ValueError) as error:  # the error must name the file
        raise ConfigurationError(
            f"{node.path / 'ca.pem'}: {error}", "enroll that node anew, or move its directory away"
        ) from error
