"""Where nodes say they listen: one spelling for each place, and none that is another's. Pure.

The master calls these addresses, so they must not lead it astray (attack M8): an address in one of
its odd spellings, the address of everybody, or loopback, which is the master's own host, said by a
node that is elsewhere. Whether the node is really there is proved when it is called, by its key.
"""

import ipaddress
import re
from functools import lru_cache
from typing import Final
from urllib.parse import urlsplit

# getaddrinfo takes 127.1, 0x7f000001 and 017700000001 for IPv4 addresses too (WHATWG URL, 3.5).
_NUMBER: Final = re.compile(r"(?:.*\.)?(?:[0-9]+|0x[0-9a-f]*)\.?", re.IGNORECASE)
_LOCAL: Final = re.compile(r"(?:.*\.)?(?:localhost|localhost\.localdomain|ip6-localhost)\.?")
_EVERYBODY: Final = "255.255.255.255"
_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
_REMEMBERED: Final = 256  # a node names its own addresses in each call


@lru_cache(_REMEMBERED)
def endpoint(uri: str) -> tuple[str, int | None]:
    """Host and port of a URI that `is_place` has seen, equal for equal places however spelt."""
    parts = urlsplit(uri)
    host = parts.hostname or ""
    address = _address(host)
    return (host.removesuffix(".") if address is None else str(address)), parts.port


def is_place(host: str) -> bool:
    """Whether one node can be at `host`: a name, or the address of one host in its usual form."""
    address = _address(host)
    if address is None:
        return bool(host) and ":" not in host and _NUMBER.fullmatch(host) is None
    return not (address.is_unspecified or address.is_multicast or str(address) == _EVERYBODY)


def is_here(host: str) -> bool:
    """Whether `host` is the host of whoever calls it."""
    address = _address(host)
    return _LOCAL.fullmatch(host) is not None if address is None else address.is_loopback


def _address(host: str) -> _Address | None:
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return address if mapped is None else mapped
