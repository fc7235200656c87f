"""The address of a node: in its code, and as a person types it."""

import re
import socket
from typing import Final

from rossec.errors import ConfigurationError
from rossec.ros.settings import is_loopback

DEFAULT_PORT: Final = 11317
JOIN_PORT: Final = 11318  # of the authority, for nodes with an invitation
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
_ELSEWHERE: Final = (
    (socket.AF_INET, "192.0.2.1", "127.0.0.1"),
    (socket.AF_INET6, "2001:db8::1", "::1"),
)


def join(host: str, port: int) -> str:
    """`host:port`, with brackets around an IPv6 address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def split(text: str, default: int = DEFAULT_PORT) -> tuple[str, int]:
    """Host and port of `text`; without a port the `default` one.

    Raises:
        ConfigurationError: not an address.
    """
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
    """The addresses at which others can probably reach this host, IPv4 first; else loopback."""
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
