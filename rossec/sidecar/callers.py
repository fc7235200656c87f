"""Which programs of this host may use the sidecar's loopback ports, and be reached by it.

The kernel's socket table tells the user at the other end. A private sidecar also wants the socket
to be held by the program it was started for, or a descendant of it: another program of the same
user is refused. What this cannot keep out: root, and a program of the same user that attaches to
one of these (ptrace) or reads the identity's files.
"""

import socket
from collections.abc import Collection
from typing import Final

from rossec.errors import PeerUserRefused
from rossec.net.host import peeruid
from rossec.net.host.peeruid import Holder
from rossec.sidecar.core.endpoints import LOOPBACK, Loopback
from rossec.sidecar.socket_owners import SocketOwners

_HINT: Final = "start it with `rossec run`; one with capabilities needs `rossec sidecar`"


class Callers:
    """Who may call.

    Args:
        users: their user ids.
        ancestor: the process whose descendants may; None: any process of these users.
        loopback: where they call, and are reached.
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

    async def check(self, sock: socket.socket) -> None:
        """Return if a program that may is at the other end.

        Raises:
            PeerUserRefused: it may not, or nobody knows who it is.
        """
        await self._check(peeruid.holder_of(sock))

    async def check_listener(self, port: int) -> list[Holder]:
        """Return who listens at the loopback port `port`, if that is a program that may.

        Whoever connects then asks `check_unchanged`: the program may end in between, and anybody
        take its port.

        Raises:
            PeerUserRefused: one of those who listen there may not be reached.
            ConnectionRefusedError: nobody does.
        """
        holders = self.listeners(port)
        if not holders:
            raise ConnectionRefusedError(f"nobody listens at port {port}")
        for holder in holders:
            await self._check(holder)
        return holders

    def check_unchanged(self, port: int, holders: list[Holder]) -> None:
        """Return if those who were found to listen at `port` still do.

        Raises:
            ConnectionRefusedError: it has changed hands.
        """
        if self.listeners(port) != holders:
            raise ConnectionRefusedError(f"port {port} has changed hands")

    def listeners(self, port: int) -> list[Holder]:
        """Who listens at the loopback port `port`, whether they may be reached or not."""
        return peeruid.listeners((self.loopback.address, port))

    async def _check(self, holder: Holder) -> None:
        if holder.user not in self._users or not peeruid.is_known(holder.user):
            raise PeerUserRefused(f"user {holder.user} may not use this sidecar", _HINT)
        if self._owners is not None and not await self._owners.holds(holder.inode):
            raise PeerUserRefused("this sidecar belongs to another program", _HINT)
