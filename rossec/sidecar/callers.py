"""Access control for programs of this host, at loopback ports and at their own listening ports.

The kernel's socket table gives the user at the other end. A private sidecar also requires that the
program it was started for, or a descendant of it, owns the socket: another program of the same
user is refused. Not kept out: root, and a program of the same user that attaches to one of these
(ptrace) or reads the identity's files.
"""

import socket
from collections.abc import Collection
from typing import Final

from rossec.errors import PeerUserRefused
from rossec.net.host import peeruid
from rossec.net.host.peeruid import Holder
from rossec.sidecar.core.endpoints import LOOPBACK, Loopback
from rossec.sidecar.socket_owners import SocketOwners

_ALL: Final = 1  # the process that all others descend from
_HINT: Final = "start it with `rossec run`; a program with capabilities needs `rossec sidecar`"


class Callers:
    """The allowed programs.

    Args:
        users: the allowed user ids.
        ancestor: the process whose descendants are allowed; None: any process of these users.
        loopback: the address of sidecar and programs.
    """

    def __init__(
        self,
        users: Collection[int],
        ancestor: int | None = None,
        loopback: Loopback = LOOPBACK,
    ) -> None:
        self.loopback: Final = loopback
        self._users = frozenset(users)
        self._owners = None if ancestor is None else SocketOwners(ancestor)
        self._processes = self._owners or SocketOwners(_ALL)

    async def check(self, sock: socket.socket) -> None:
        """Return if the program at the other end is allowed.

        Raises:
            PeerUserRefused: it is not, or its user is unknown.
        """
        await self._check(peeruid.holder_of(sock))

    async def check_listener(self, port: int) -> list[Holder]:
        """Return the sockets that listen at loopback port `port`, if their programs are allowed.

        After connecting, call `check_unchanged`: the program may have ended in between, and another
        one have bound its port.

        Raises:
            PeerUserRefused: a program that listens there is not allowed.
            ConnectionRefusedError: no program listens there.
        """
        holders = self.listeners(port)
        if not holders:
            raise ConnectionRefusedError(f"no program listens at port {port}")
        for holder in holders:
            await self._check(holder)
        return holders

    def check_unchanged(self, port: int, holders: list[Holder]) -> None:
        """Return if the same sockets still listen at `port`.

        Raises:
            ConnectionRefusedError: another program listens there now.
        """
        if self.listeners(port) != holders:
            raise ConnectionRefusedError(f"another program listens at port {port} now")

    def listeners(self, port: int) -> list[Holder]:
        """The sockets that listen at loopback port `port`, allowed or not."""
        return peeruid.listeners((self.loopback.address, port))

    async def is_program_at(self, sock: socket.socket, port: int) -> bool:
        """Whether the process at the other end of `sock` listens at loopback port `port`.

        Raises:
            PeerUserRefused: no process holds that end.
        """
        caller = await self._processes.process_of(peeruid.holder_of(sock).inode)
        holders = [await self._processes.process_of(each.inode) for each in self.listeners(port)]
        return caller is not None and caller in holders

    async def _check(self, holder: Holder) -> None:
        if holder.user not in self._users or not peeruid.is_known(holder.user):
            raise PeerUserRefused(f"user {holder.user} may not use this sidecar", _HINT)
        if self._owners is not None and not await self._owners.holds(holder.inode):
            raise PeerUserRefused("this sidecar belongs to another program", _HINT)
