"""The sockets of an endpoint, listening before anything that talks to strangers starts. A shell."""

import errno
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import Final

from rossec.console.options import Endpoint
from rossec.errors import ConfigurationError
from rossec.operation.unix_socket import listen_at

BACKLOG: Final = 128


def listen(endpoint: Endpoint) -> list[socket.socket]:
    """Sockets that listen where `endpoint` says; a host without IPv6 has one less.

    Raises:
        ConfigurationError: the port or the path is used by another program, or not allowed.
    """
    if endpoint.unix_path is not None:
        return [listen_for_proxy(endpoint.unix_path, shared=endpoint.proxy_user is not None)]
    return listen_tcp(endpoint.addresses, endpoint.port)


def listen_tcp(addresses: tuple[str, ...], port: int) -> list[socket.socket]:
    """As `listen`, at a port of these addresses."""
    found = list[socket.socket]()
    try:
        for address in addresses:
            with suppress(_NoSuchAddress):
                found.append(_listen_at(address, port))
    except BaseException:
        for sock in found:
            sock.close()
        raise
    if not found:
        raise ConfigurationError("this host has none of the addresses", "is the loopback up?")
    return found


class _NoSuchAddress(Exception):
    """This host has no such address, or no such family."""


def _listen_at(address: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        sock = socket.socket(family, socket.SOCK_STREAM)
    except OSError as error:
        raise _NoSuchAddress from error
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        sock.bind((address, port))
        sock.listen(BACKLOG)
    except OSError as error:
        sock.close()
        if error.errno in {errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT}:
            raise _NoSuchAddress from error
        reason = os.strerror(error.errno or 0).lower()
        raise ConfigurationError(
            f"cannot listen at port {port}: {reason}", "choose another one: --port N"
        ) from error
    return sock


def listen_for_proxy(path: Path, *, shared: bool) -> socket.socket:
    """A unix socket at `path`; one that nobody listens at any more is replaced.

    With `shared` every user can connect, and who does is asked of the kernel: else the mode lets
    no other user in.

    Raises:
        ConfigurationError: another program listens there, or something else is there.
    """
    if _is_used(path):
        raise ConfigurationError(f"{path} is used by another program", "choose another --unix PATH")
    try:
        path.unlink(missing_ok=True)
        sock = listen_at(path, BACKLOG)
    except OSError as error:
        raise ConfigurationError(
            f"cannot listen at {path}: {os.strerror(error.errno or 0).lower()}",
            "choose another --unix PATH",
        ) from error
    if shared:
        path.chmod(0o666)
    return sock


def _is_used(path: Path) -> bool:
    """Whether a program listens at `path`, or it is not a socket."""
    if not os.path.lexists(path):
        return False
    if not path.is_socket():
        return True
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            return False
        except OSError:
            return True
    return True
