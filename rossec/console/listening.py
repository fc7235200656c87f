"""The sockets of an endpoint, listening before strangers are talked to; and where a console is. A shell.

The address is written when the console begins, for the commands that show codes.
"""

import errno
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from rossec import files
from rossec.authority.console.messages import ADDRESS, LOCK
from rossec.console.options import ConsoleEndpoint
from rossec.errors import ConfigurationError
from rossec.host.local_sockets import listen_at, process_lock

BACKLOG: Final = 128
NAME: Final = ADDRESS  # in the authority's directory
_MAX: Final = 512
_NONE: Final = ConfigurationError("no console runs", "start it in another terminal: rossec console")


@contextmanager
def only_console(directory: Path) -> Iterator[None]:
    # One at a time: phones belong to one address, and codes lead to it. One that was killed leaves the
    # address behind, which harms nobody: it answers nothing, and a code is worth nothing there.
    (directory / LOCK).parent.mkdir(mode=0o700, exist_ok=True)
    busy = ConfigurationError(
        "another console of this authority runs",
        "end that one; to show the pages only: --read-only, and another --port",
    )
    with process_lock(directory / LOCK, busy):
        try:
            yield
        finally:
            with suppress(OSError):
                (directory / NAME).unlink()


def write_address(directory: Path, origin: str) -> None:
    path = directory / NAME
    files.make_private_directory(path.parent)
    files.replace(path, origin.encode())


def read_address(directory: Path) -> str:
    return files.read_own(directory / NAME, _MAX, _NONE).decode(errors="replace")


def listen(endpoint: ConsoleEndpoint) -> list[socket.socket]:
    if endpoint.unix_path is not None:
        return [listen_for_proxy(endpoint.unix_path, shared=endpoint.proxy_user is not None)]
    return listen_tcp(endpoint.addresses, endpoint.port)


def listen_tcp(addresses: tuple[str, ...], port: int) -> list[socket.socket]:
    with ExitStack() as opened:
        found = list[socket.socket]()
        for address in addresses:
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            try:
                sock = opened.enter_context(socket.socket(family, socket.SOCK_STREAM))
            except OSError:  # this host has no such addresses
                continue
            try:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                sock.bind((address, port))
                sock.listen(BACKLOG)
            except OSError as error:
                if error.errno in {errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT}:
                    sock.close()
                    continue
                said = f"cannot listen at port {port}: {os.strerror(error.errno or 0).lower()}"
                raise ConfigurationError(said, "choose another one: --port N") from error
            found.append(sock)
        if not found:
            raise ConfigurationError("this host has none of the addresses", "is the loopback up?")
        opened.pop_all()
        return found


def listen_for_proxy(path: Path, *, shared: bool) -> socket.socket:
    # One that nobody listens at any more is replaced. With `shared` every user can connect, and who does is
    # asked of the kernel: else the mode lets no other user in.
    if _is_used(path):
        raise ConfigurationError(f"{path} is used by another program", "choose another --unix PATH")
    try:
        path.unlink(missing_ok=True)
        sock = listen_at(path, BACKLOG)
    except OSError as error:
        said = f"cannot listen at {path}: {os.strerror(error.errno or 0).lower()}"
        raise ConfigurationError(said, "choose another --unix PATH") from error
    if shared:
        path.chmod(0o666)
    return sock


def _is_used(path: Path) -> bool:
    # Whether a program listens at `path`, or it is not a socket.
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
