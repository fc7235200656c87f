"""The hosts in the URIs that nodes register: validated and normalized. Pure.

The master connects to these addresses, so it accepts neither unusual spellings of an IPv4 address
nor broadcast and multicast addresses, nor loopback, which is the master's own host, from a node on
another host (attack M8). That the node listens there is proved by its key when it is called.
"""

import ipaddress
import re
from functools import lru_cache
from typing import Final
from urllib.parse import urlsplit

# getaddrinfo takes 127.1, 0x7f000001 and 017700000001 for IPv4 addresses too (WHATWG URL, 3.5).
_NUMERIC_HOST: Final = re.compile(r"(?:.*\.)?(?:[0-9]+|0x[0-9a-f]*)\.?", re.IGNORECASE)
_LOCALHOST: Final = re.compile(r"(?:.*\.)?(?:localhost|localhost\.localdomain|ip6-localhost)\.?")
_BROADCAST: Final = "255.255.255.255"
_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
_CACHE_SIZE: Final = 256  # a node sends its own URIs in each call


@lru_cache(_CACHE_SIZE)
def endpoint(uri: str) -> tuple[str, int | None]:
    """Host and port of a URI, normalized: equal for each spelling of one endpoint."""
    parts = urlsplit(uri)
    host = parts.hostname or ""
    address = _address(host)
    return (host.removesuffix(".") if address is None else str(address)), parts.port


def is_unicast_host(host: str) -> bool:
    """Whether `host` is a name, or a unicast IP address in its standard spelling."""
    address = _address(host)
    if address is None:
        return bool(host) and ":" not in host and _NUMERIC_HOST.fullmatch(host) is None
    return not (address.is_unspecified or address.is_multicast or str(address) == _BROADCAST)


def is_loopback_host(host: str) -> bool:
    """Whether `host` is loopback: an address of it, or a name of localhost."""
    address = _address(host)
    return _LOCALHOST.fullmatch(host) is not None if address is None else address.is_loopback


def _address(host: str) -> _Address | None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return address if mapped is None else mapped
