"""Addresses as stock rospy has them: IPv6 without brackets, sockets of one family. Pure."""

import ipaddress
import socket
from typing import Final

from rossec.errors import ConfigurationError

ROSRPC: Final = "rosrpc://"


def bracketed(uri: str) -> str:
    """`uri` with brackets around an IPv6 literal that lacks them; any other as it is."""
    scheme, mark, rest = uri.partition("://")
    authority, slash, path = rest.partition("/")
    host, colon, port = authority.rpartition(":")
    if ":" not in host or host.startswith("["):
        return uri
    return f"{scheme}{mark}[{host}]{colon}{port}{slash}{path}"


def parse_rosrpc(uri: str) -> tuple[str, int]:
    """Host and port of a service's URI.

    Raises:
        ConfigurationError: invalid.
    """
    authority = uri.removeprefix(ROSRPC).partition("/")[0]
    host, _, port = authority.rpartition(":")
    if not uri.startswith(ROSRPC) or not host or not port.isdecimal():
        raise ConfigurationError(
            f"{uri!r} is not the URI of a service", "it has the form rosrpc://host:port"
        )
    return host.removeprefix("[").removesuffix("]"), int(port)


def for_family(family: int, address: tuple[str, int]) -> tuple[str, int]:
    """`address` as a socket of this family takes it: an IPv4 literal for IPv6 is mapped.

    With ROS_IPV6=on all sockets of rospy are of IPv6; a relay's doors are at 127.0.0.1.
    """
    host, port = address
    try:
        mapped = family == socket.AF_INET6 and ipaddress.ip_address(host).version == 4
    except ValueError:  # a name
        return address
    return (f"::ffff:{host}", port) if mapped else address
