"""Connections that a relay of this host brings: they come from loopback, but nobody is near.

A relay connects to targets on its own host from an address of its own in 127.82.0.0/16, one for
each remote relay. What a server allows local callers is not for these, and its limits for one
address hold for each remote relay. Another program that binds such an address only gives up being
local.
"""

import hashlib
import ipaddress
from typing import Final

from rossec.ros.settings import is_loopback

_SOURCES: Final = ipaddress.ip_network("127.82.0.0/16")


def source_for(relay: str) -> str:
    """The address from which connections of a remote relay are made on this host.

    `relay`: its name here (`/remote/hospital/relay`). Two relays may share one.
    """
    offset = int.from_bytes(hashlib.sha256(relay.encode()).digest()[:2])
    return str(_SOURCES[min(max(offset, 1), _SOURCES.num_addresses - 2)])


def is_relayed(address: str) -> bool:
    """Whether a connection from `address` was brought by a relay of this host."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return False
    mapped = getattr(found, "ipv4_mapped", None)
    return (mapped or found) in _SOURCES


def is_near(address: str, local_address: str) -> bool:
    """Whether the caller at `address` is a program of this host that came by no relay."""
    local = is_loopback(address) or address == local_address
    return local and not is_relayed(address)
