"""Whether the address that a node gives away is one of this host. A shell.

The commonest fault of a ROS network: the address of yesterday, or a name that only one host knows.
Who gives it away notices nothing; who is given it finds nobody there. Behind a translated address
(a container, NAT) it may be right all the same, so nothing is refused.
"""

import ipaddress
import socket
from collections.abc import Callable, Mapping
from threading import Thread
from typing import Final

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.ros.text import printable

_SET: Final = "set ROS_IP to an address of this host: ip address"


def variable_of(variables: Mapping[str, str]) -> str:
    """Which variable says the address: as in ROS, ROS_HOSTNAME before ROS_IP."""
    return "ROS_HOSTNAME" if "ROS_HOSTNAME" in variables else "ROS_IP"


def check_own_address(address: str, variable: str) -> str:
    """What to say of an address of this host; a name is asked of the resolver.

    Raises:
        ConfigurationError: it leads elsewhere, or nowhere.
    """
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
    """Call `warn` if the address that a node begins to give away is not one of this host.

    A name is looked up in a thread of its own, which ends with the process: a resolver may take
    long, and nobody waits for it.
    """
    if address is None:
        return

    def check() -> None:
        try:
            check_own_address(address, variable_of(variables))
        except ConfigurationError as error:
            warn(error)

    if _is_numeric(address):
        check()
    else:
        Thread(target=check, name="own address", daemon=True).start()


def resolved(host: str) -> list[tuple[int, str]]:
    """Family and address of each, none for a name that is not known."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, ValueError):  # UnicodeError: no host name at all
        return []
    return [(family, str(where[0])) for family, _, _, _, where in found]


def _is_numeric(address: str) -> bool:
    try:
        ipaddress.ip_address(address)
    except ValueError:
        return False
    return True


def _is_here(place: tuple[int, str]) -> bool:
    family, address = place
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sock:
            sock.bind((address, 0))
    except OSError:
        return False
    return True
