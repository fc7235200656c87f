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
URI_LIMIT: Final = 512
Endpoint = tuple[str, int | None]
"""Host and port, normalized."""
_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
_CACHE_SIZE: Final = 256  # a node sends its own URIs in each call


@lru_cache(_CACHE_SIZE)
def endpoint(uri: str) -> Endpoint:
    """Host and port of a URI, normalized: equal for each spelling of one endpoint."""
    parts = urlsplit(uri)
    host = parts.hostname or ""
    address = _address(host)
    return (host.removesuffix(".") if address is None else str(address)), parts.port


@lru_cache(_CACHE_SIZE)
def is_connectable(uri: str, scheme: str) -> bool:
    """Whether `uri` is of `scheme`, and has a host and a port to connect to."""
    if len(uri) > URI_LIMIT or not uri.isascii() or not uri.isprintable() or " " in uri:
        return False
    try:
        parts = urlsplit(uri)
        port = parts.port
    except ValueError:
        return False
    host = parts.hostname or ""
    return parts.scheme == scheme and is_unicast_host(host) and bool(port) and "@" not in uri


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


def is_reachable_from_here(host: str) -> bool:
    """Whether `host`, in an address that another host named, can be that host's.

    Loopback and link-local addresses mean another machine here than there.
    """
    address = _address(host)
    if address is None:
        return not is_loopback_host(host)
    return not (address.is_loopback or address.is_link_local)


def _address(host: str) -> _Address | None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return address if mapped is None else mapped
