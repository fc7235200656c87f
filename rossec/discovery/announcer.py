"""The master's side: announce its address on every link, periodically."""

import asyncio
import logging
import secrets
from itertools import count
from typing import Final

from rossec import clock
from rossec.channel.edhoc.credentials import Credentials
from rossec.discovery.announcement import INSTANCE_SIZE, Announcement, sign
from rossec.discovery.multicast import MulticastSocket
from rossec.errors import ConfigurationError
from rossec.ros.settings import is_loopback, parse_uri

PERIOD: Final = 0.5  # enough in four seconds to measure the loss
_log = logging.getLogger("rossec.master")


async def announce(credentials: Credentials, uri: str, *, period: float = PERIOD) -> None:
    """Announce the master at `uri` until cancelled.

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
            sent = group.send(sign(credentials.signer, credentials.chain, announcement)) > 0
            if sent is not was_sent:
                _log.warning("announcing on %s", "the links again" if sent else "no link: all down")
            was_sent = sent
            await asyncio.sleep(period)
    finally:
        group.close()
