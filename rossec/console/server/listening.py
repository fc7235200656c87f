"""The sockets at which the console listens: made by the supervisor, inherited by the web process."""

import errno
import os
import socket
from contextlib import ExitStack
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from rossec.console.options import Endpoint
from rossec.errors import ConfigurationError

BACKLOG: Final = 128
_NO_IPV6: Final = frozenset({errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT})


def listen(endpoint: Endpoint) -> list[socket.socket]:
    """Sockets that listen at every address of an endpoint, or at its path.

    An address of IPv6 may be missing, as hosts without it exist; one of IPv4 may not.

    Raises:
        ConfigurationError: an address is taken, or may not be used.
    """
    if endpoint.unix_path is not None:
        return [_listen_unix(endpoint.unix_path)]
    with ExitStack() as stack:
        found = []
        for address in endpoint.addresses:
            sock = _listen_tcp(address, endpoint.port)
            if sock is not None:
                found.append(stack.enter_context(sock))
        stack.pop_all()
        return found


def _listen_tcp(address: str, port: int) -> socket.socket | None:
    is_ipv6 = ip_address(address).version == 6
    try:
        sock = socket.socket(socket.AF_INET6 if is_ipv6 else socket.AF_INET)
    except OSError:
        if is_ipv6:
            return None
        raise
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if is_ipv6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        sock.bind((address, port))
        sock.listen(BACKLOG)
    except OSError as error:
        sock.close()
        if is_ipv6 and error.errno in _NO_IPV6:
            return None
        reason = os.strerror(error.errno or 0).lower()
        raise ConfigurationError(
            f"cannot listen on port {port}: {reason}", "choose another one: --port PORT"
        ) from error
    return sock


def _listen_unix(path: Path) -> socket.socket:
    """A socket for a proxy; whoever may write to its directory decides who connects.

    Raises:
        ConfigurationError: something is there that is no socket, or it cannot be made.
    """
    if path.exists() and not path.is_socket():
        raise ConfigurationError(f"{path} is not a socket", "choose another path: --unix PATH")
    sock = socket.socket(socket.AF_UNIX)
    before = os.umask(0o117)  # the proxy is of the same user or group
    try:
        path.unlink(missing_ok=True)
        sock.bind(str(path))
        sock.listen(BACKLOG)
    except OSError as error:
        sock.close()
        reason = (error.strerror or str(error)).lower()
        raise ConfigurationError(f"{path}: {reason}", "choose another path: --unix PATH") from error
    finally:
        os.umask(before)
    return sock
