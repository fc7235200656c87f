"""What may stay plain while a fleet migrates: named topics and services, nothing else. Pure.

An entry is a name (`/chatter`), for any peer, or a name and an address, for one
(`/chatter@192.168.1.7`). A plain connection is neither encrypted nor authenticated. It never takes
the way of a relay: behind that loopback address is anyone.
"""

import ipaddress
from collections.abc import Iterable

from ca.errors import NameRefused
from ca.names import check_name
from rossec.errors import ConfigurationError
from rossec.net.host.relayed import is_relayed

_HINT = "an entry is a topic's or a service's name, /name or /name@address"


class PlainConnection:
    """A connection that `allow_plain` names: not authorized, and without an expiry."""

    guard = None
    ends = float("inf")


class PlainPeers:
    """The entries of `allow_plain`.

    Raises:
        ConfigurationError: an entry is invalid.
    """

    def __init__(self, entries: Iterable[str] = ()) -> None:
        self.entries = tuple(entries)
        self._allowed = frozenset(map(_parse, self.entries))

    def __bool__(self) -> bool:
        return bool(self._allowed)

    def allows(self, name: str, address: str) -> bool:
        """Whether `name` may be used unencrypted with the peer at `address`."""
        if is_relayed(address):
            return False
        return (name, None) in self._allowed or (name, _canonical(address)) in self._allowed


def _parse(entry: str) -> tuple[str, str | None]:
    name, mark, address = entry.partition("@")
    try:
        return check_name(name), _canonical(address) if mark else None
    except (NameRefused, ValueError) as error:
        raise ConfigurationError(f"allow_plain holds {entry!r}: {error}", _HINT) from error


def _canonical(address: str) -> str:
    parsed = ipaddress.ip_address(address)
    mapped = parsed.ipv4_mapped if isinstance(parsed, ipaddress.IPv6Address) else None
    return str(mapped or parsed)
