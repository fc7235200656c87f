"""The master's side: announce its address on every link, periodically.

The announcement carries the version of the master's graph. Nodes of rossec before there were
several masters refuse a field they do not know; for them `/master` sends the same once more without
the version, with the same number: others take it for a duplicate before they check a signature.
"""

import asyncio
import logging
import secrets
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Final

from ca.names import MASTER
from rossec import clock
from rossec.channel.edhoc.credentials import Credentials
from rossec.discovery.announcement import INSTANCE_SIZE, Announcement, sign
from rossec.discovery.multicast import MulticastSocket
from rossec.errors import ConfigurationError
from rossec.ros.settings import is_loopback, parse_uri

PERIOD: Final = 0.5  # enough in four seconds to measure the loss
_log = logging.getLogger("rossec.master")


async def announce(
    credentials: Credentials,
    uri: str,
    *,
    name: str = MASTER,
    version: Callable[[], int] = lambda: 0,
    period: float = PERIOD,
) -> None:
    """Announce the master at `uri` until cancelled.

    Args:
        name: its certified name.
        version: of its graph now; counts up.

    Raises:
        ConfigurationError: other hosts cannot reach it there.
        AnnouncementRefused: its name is too long for a datagram.
        OSError: no IPv6 on this host.
    """
    host, port = parse_uri(uri, "the master's URI")
    if is_loopback(host):
        raise ConfigurationError(
            f"the master at {uri} cannot be announced: only this host reaches it",
            "set ROS_IP or ROS_HOSTNAME to an address of the network",
        )
    instance = secrets.token_bytes(INSTANCE_SIZE)
    group = MulticastSocket(listen=False)
    was_sent = True
    try:
        for seq in count():
            announcement = Announcement(host, port, instance, seq, clock.now())
            links = [
                group.send(sign(credentials.signer, credentials.chain, form))
                for form in _forms(announcement, name, version())
            ]
            sent = any(links)
            if sent is not was_sent:
                _log.warning("announcing on %s", "the links again" if sent else "no link: all down")
            was_sent = sent
            await asyncio.sleep(period)
    finally:
        group.close()


def _forms(announcement: Announcement, name: str, version: int) -> Iterator[Announcement]:
    yield replace(announcement, version=version % (1 << 31))
    if name == MASTER:
        yield announcement
