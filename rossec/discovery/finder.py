"""The node's side: listen, probe announced masters, and choose the one with the best link.

A shell around `candidates`. A probe opens a TCP connection and closes it: it measures the round
trip and nothing else. A sidecar keeps the choice (a program cannot be moved to another master).
"""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from itertools import islice
from typing import Final

from ca.certificates import TrustAnchor
from rossec import clock
from rossec.discovery.candidates import Candidate, Candidates
from rossec.discovery.multicast import MulticastSocket
from rossec.errors import AnnouncementRefused, MasterNotFound
from rossec.net.aio.tasks import TaskSet
from rossec.ros.text import printable

PATIENCE: Final = 10.0  # seconds; a master announces itself twice in each
SETTLE: Final = 4.0  # seconds after the first: time to receive others and to measure their loss
_PROBE: Final = 2.0
_LOOK: Final = 0.1
_AT_ONCE: Final = 32  # datagrams
_REJOIN: Final = 1.0


async def find(
    anchor: TrustAnchor,
    revoked: frozenset[bytes] = frozenset(),
    *,
    patience: float = PATIENCE,
    settle: float = SETTLE,
) -> list[Candidate]:
    """The masters of this trust domain that can be reached, the best link first.

    Args:
        revoked: entries of the newest revocation list known.
        patience: seconds to wait for the first; `settle`: then, to measure the loss of all.

    Raises:
        MasterNotFound: none; the message has what was received instead.
        OSError: no IPv6 on this host.
    """
    candidates = Candidates(anchor, revoked)
    async with listening(candidates):
        end, found = time.monotonic() + patience, False
        while time.monotonic() < end:
            await asyncio.sleep(_LOOK)
            if not found and candidates.best(clock.now(), time.monotonic()) is not None:
                end, found = time.monotonic() + settle, True
    ranked = candidates.ranked(clock.now(), time.monotonic())
    reached = [one for one in ranked if one.rtt is not None]
    if not reached:
        raise _not_found(candidates)
    return reached


@contextlib.asynccontextmanager
async def listening(candidates: Candidates) -> AsyncIterator[None]:
    """Feed `candidates` with datagrams from all links, and probe each master."""
    group = MulticastSocket(listen=True)
    probes = TaskSet()

    def arrived() -> None:
        for data, source in islice(
            group.receive(), _AT_ONCE
        ):  # the rest in the next turn of the loop
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


async def _probe(candidates: Candidates, candidate: Candidate) -> None:
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


def _not_found(candidates: Candidates) -> MasterNotFound:
    heard = candidates.ranked(clock.now(), time.monotonic())
    if heard:
        where = ", ".join(f"{host} port {port}" for host, port in heard[0].endpoints)
        return MasterNotFound(
            f"a master announces itself, but nothing answers at {printable(where)}",
            "is a firewall between? its TCP port must be open",
        )
    if candidates.refused:
        why, times = candidates.refused.most_common(1)[0]
        return MasterNotFound(
            f"no master of this trust domain was found, but {times} times: {printable(why)}",
            "set ROS_MASTER_URI to the master of this domain",
        )
    return MasterNotFound(
        "no master announces itself on the links of this host",
        "start it with `rossec master --announce`, or set ROS_MASTER_URI",
    )
