"""Addresses: whether the one that a node gives away is this host's, whether a caller is near, and those
people type.
"""

import hashlib
import ipaddress
import re
import socket
from collections.abc import Callable, Mapping
from threading import Thread
from typing import Final

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.peer_limits import printable
from rossec.ros.names import is_loopback

DEFAULT_PORT: Final = 11317
JOIN_PORT: Final = 11318  # of the authority, for nodes with an invitation
_SET: Final = "set ROS_IP to an address of this host: ip address"
# A relay connects to targets on its own host from an address of its own, one for each remote relay: such
# connections come from loopback, but nobody is near, and the limits for one address hold for each remote
# relay. Another program that binds such an address only gives up being local.
_SOURCES: Final = ipaddress.ip_network("127.82.0.0/16")
# A name of labels, or an address with its zone: codes are untrusted, and the resolver
# raises exceptions of its own for an empty label, a long one or a NUL.
_HOST: Final = re.compile(
    r"(?=.{1,253}$)(?:[A-Za-z0-9_](?:[A-Za-z0-9_-]{0,62}))(?:\.[A-Za-z0-9_-]{1,63})*\.?"
    r"|(?=[^%]*:)[0-9A-Fa-f:.]{2,45}(?:%[A-Za-z0-9_.-]{1,32})?",
    re.ASCII,
)
_PORT: Final = re.compile(r"[0-9]{1,5}", re.ASCII)
_EXAMPLE: Final = f"write it as 192.168.1.7:{DEFAULT_PORT}, [fd00::7]:{DEFAULT_PORT} or robot.local"
# Documentation addresses (RFC 5737, RFC 3849): connecting a UDP socket sends nothing, it only
# asks the routing table which local address would be used.
_ELSEWHERE: Final = ((socket.AF_INET, "192.0.2.1", "127.0.0.1"), (socket.AF_INET6, "2001:db8::1", "::1"))


def variable_of(variables: Mapping[str, str]) -> str:
    return "ROS_HOSTNAME" if "ROS_HOSTNAME" in variables else "ROS_IP"


def check_own_address(address: str, variable: str) -> str:
    what = f"{variable} is {printable(address)}"
    found = resolved(address)
    if not found:
        raise ConfigurationError(
            f"{what}, a name that this host does not know: others will hardly know it either",
            "set ROS_IP to the address of this host, or enter the name in /etc/hosts of all hosts",
        )
    if not any(_is_here(each) for each in found):
        raise ConfigurationError(
            f"{what}, which is no address of this host: peers connect there and do not find it",
            f"unset {variable}, or {_SET}",
        )
    return f"{what}, an address of this host"


def warn_of_own_address(
    address: str | None, variables: Mapping[str, str], warn: Callable[[HintedError], None]
) -> None:
    """Call `warn` if the address that a node begins to give away is not one of this host."""
    # The commonest fault of a ROS network: the address of yesterday, or a name that only one host knows. Who
    # gives it away notices nothing. Behind NAT, or in a container, it may be right all the same: no refusal.
    if address is None:
        return

    def check() -> None:
        try:
            check_own_address(address, variable_of(variables))
        except ConfigurationError as error:
            warn(error)

    try:
        ipaddress.ip_address(address)
    except ValueError:
        # A resolver may take long, and nobody waits for it: the thread ends with the process.
        Thread(target=check, name="own address", daemon=True).start()
    else:
        check()


def resolved(host: str) -> list[tuple[int, str]]:
    """Family and address of each, none for a name that is not known."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, ValueError):  # UnicodeError: no host name at all
        return []
    return [(family, str(where[0])) for family, _, _, _, where in found]


def _is_here(place: tuple[int, str]) -> bool:
    family, address = place
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sock:
            sock.bind((address, 0))
    except OSError:
        return False
    return True


def source_for(relay: str) -> str:
    """The address from which connections of a remote relay are made on this host. `relay`: its name here
    (`/remote/hospital/relay`). Two relays may share one."""
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


def join(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def split(text: str, default: int = DEFAULT_PORT) -> tuple[str, int]:
    host, port = text, str(default)
    if text.startswith("["):
        host, _, rest = text[1:].partition("]")
        port = rest.removeprefix(":") if rest else port
    elif text.count(":") == 1:
        host, _, port = text.partition(":")
    if not _HOST.fullmatch(host) or not _PORT.fullmatch(port) or not 0 < int(port) < 1 << 16:
        raise ConfigurationError(f"{text!a} is not an address of a node", _EXAMPLE)
    return host, int(port)


def own_addresses() -> list[str]:
    found = [_towards(family, where) for family, where, _ in _ELSEWHERE]
    usable = [address for address in found if address and not is_loopback(address)]
    return usable or [loopback for _, _, loopback in _ELSEWHERE]


def _towards(family: int, where: str) -> str:
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sock:
            sock.connect((where, 9))
            return str(sock.getsockname()[0])
    except OSError:  # no route, or no such family
        return ""
