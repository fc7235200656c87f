"""From a revocation to the last byte that a revoked subscriber of one publisher receives.

The subscribers are another process, which after the connection headers only notes when bytes arrive and when
they end: opening them there would be measured too. One node's processor time is measured beside the wall
clock, which others on the machine disturb.
"""

import asyncio
import multiprocessing
import os
import select
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, Final
from unittest import mock

from bench._masters import EnrolledNode, enroll
from ca.certificates import TrustAnchor
from ca.encoding import encode
from grants.document import grant_id
from grants.model import Right
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureContext, connect
from rossec.net.aio.transport import Transport
from rossec.node import Node
from rossec.participant.access import FIELD
from rossec.participant.handshakes import TopicEndpoint
from rossec.participant.message_types import message_type
from rossec.ros import tcpros
from tests.support.site import Site

TOPIC: Final = "/chatter"
KIND: Final = "std_msgs/String"
GIVE_UP: Final = 60.0
_READ: Final = 64 * 1024
_AT_ONCE: Final = 8  # connections that are being made


async def revocation(site: Site, environ: dict[str, str], count: int, revoked: int) -> dict[str, float]:
    """Milliseconds for `count` subscribers of one publisher, of whose grants one list revokes `revoked`.

    `from_master_*`: from the moment the master has the list, `from_arrival_*` from that at which the node
    has it. `cut_cpu`: the node's processor time from there to the last socket that is shut, `cpu` to the
    last word about one.
    """
    site.grant("/robot", Right.PUBLISH, TOPIC)
    members = [enroll(site, f"/viewer{n}", {TOPIC: Right.SUBSCRIBE}) for n in range(count)]
    ours, theirs = multiprocessing.Pipe()
    viewers = multiprocessing.get_context("fork").Process(target=_view, args=(theirs, site.anchor, members))
    viewers.start()
    talking = TaskSet()
    try:
        async with Node("/robot", environ=environ) as robot:
            publisher = await robot.publisher(TOPIC, KIND)
            ours.send(robot.topic_endpoint())
            async with asyncio.timeout(120):
                await publisher.wait_for_subscribers(count)
            await asyncio.to_thread(ours.recv)  # all of them are watched
            talking.spawn(_talk(publisher, max(0.01, count / 5000)), "messages")
            try:
                await asyncio.sleep(0.5)
                chosen = members[:: max(1, count // revoked)][:revoked]
                data = _revoke(site, chosen)
                with _timed(robot) as at:
                    ours.send([members.index(each) for each in chosen])
                    begin = time.perf_counter()
                    await robot._membership.session.call("rossec.updateRevocations", data)  # noqa: SLF001 - as its master would
                    ends: list[float] = await asyncio.to_thread(ours.recv)
            finally:
                await talking.close()
    finally:
        viewers.join(5)
        viewers.kill()
    found = {"cut_cpu": at["cut"] - at["cpu"], "cpu": at["done"] - at["cpu"]}
    for name, since in (("from_master", begin), ("from_arrival", at["wall"])):
        taken = sorted(end - since for end in ends)
        for share, word in ((0.5, "p50"), (0.99, "p99"), (1.0, "max")):
            found[f"{name}_{word}"] = taken[min(len(taken) - 1, int(share * len(taken)))]
    return {name: round(1000 * value, 2) for name, value in found.items()}


@contextmanager
def _timed(robot: Node) -> Iterator[dict[str, float]]:
    # When the list comes, when the last socket is shut for it, and when all is done.
    at: dict[str, float] = {}
    membership, disconnect = robot._membership, Transport.disconnect  # noqa: SLF001 - what is timed
    update = membership.update_revocations

    def timed_update(revocations: bytes, *rest: Any) -> None:
        if at or not revocations:
            return update(revocations, *rest)
        at.update(wall=time.perf_counter(), cpu=time.process_time())
        try:
            return update(revocations, *rest)
        finally:
            at["done"] = time.process_time()

    def timed_disconnect(transport: Transport) -> None:
        disconnect(transport)
        if at and "done" not in at:
            at["cut"] = time.process_time()

    with (
        mock.patch.object(membership, "update_revocations", timed_update),
        mock.patch.object(membership.session, "_refresh", timed_update),  # a heartbeat may be first
        mock.patch.object(Transport, "disconnect", timed_disconnect),
    ):
        yield at


def _revoke(site: Site, members: Sequence[EnrolledNode]) -> bytes:
    """One list that revokes all their grants."""
    now = site.now()
    for member in members:
        site.authority.store.revoke(grant_id(member.grant), "bench", now)
    site.authority.sign_list(now)
    data = site.authority.store.newest_list()
    assert data is not None
    return data


async def _talk(publisher: Any, period: float) -> None:
    while True:
        publisher.publish(publisher.create(data="x" * 64))
        await asyncio.sleep(period)


# In the process of the subscribers


def _view(told: Connection, anchor: TrustAnchor, members: Sequence[EnrolledNode]) -> None:
    address = told.recv()
    sockets = asyncio.run(_join(address, anchor, members))
    told.send(len(sockets))
    poll = select.epoll()
    for sock in sockets:
        poll.register(sock, select.EPOLLIN)
    poll.register(told.fileno(), select.EPOLLIN)
    by_number = {sock.fileno(): sock for sock in sockets}
    revoked: tuple[int, ...] = ()
    left: set[int] | None = None
    last: dict[int, float] = {}
    end = time.monotonic() + 2 * GIVE_UP
    while left is None or left:
        if time.monotonic() > end:
            raise TimeoutError("a revoked subscriber is still connected")
        for number, _ in poll.poll(1.0):
            if number == told.fileno():
                left = {sockets[index].fileno() for index in told.recv()}
                revoked = tuple(left)
                continue
            try:
                data = by_number[number].recv(_READ)
            except OSError:  # reset
                data = b""
            last[number] = time.perf_counter()
            if not data:
                poll.unregister(number)
                if left is not None:
                    left.discard(number)
    told.send([last[number] for number in revoked])


async def _join(
    address: tuple[str, int], anchor: TrustAnchor, members: Sequence[EnrolledNode]
) -> list[socket.socket]:
    kind = message_type(KIND)
    endpoint = TopicEndpoint(TOPIC, kind)
    turn = asyncio.Semaphore(_AT_ONCE)

    async def join(member: EnrolledNode) -> socket.socket:
        async with turn:
            stream = await connect(*address, SecureContext(member.credentials, anchor.verify))
            fields: dict[str, str | bytes] = {
                "callerid": member.name,
                "topic": endpoint.topic,
                "type": kind.name,
                "md5sum": kind.md5sum,
                FIELD: encode([member.grant]),
            }
            await stream.send(tcpros.encode(fields))
            await stream.receive()
            stream.transport.pause_reading()
            return socket.socket(fileno=os.dup(stream.transport._fd))  # type: ignore[attr-defined]  # noqa: SLF001 - reads below the channel

    return await asyncio.gather(*map(join, members))
