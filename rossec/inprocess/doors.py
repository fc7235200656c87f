"""Makes the secure connections of one process, both ways; `sockets` dresses them for rospy."""

import secrets
import socket
from typing import Final

from ca.certificates import Identity
from rossec.channel.connection import Connection
from rossec.channel.opening import Flavour
from rossec.inprocess.member import Member, now
from rossec.net.blocking import SecureSocket
from rossec.net.bounds import ACCEPTED, DIALLED
from rossec.net.halfopen import HalfOpen, HalfOpenCount

CONNECT_TIMEOUT: Final = 10.0

Stream = SecureSocket[Identity]


class Doors:
    """Makes the secure connections of one process, both ways."""

    def __init__(self, member: Member, half_open: HalfOpen = HalfOpen()) -> None:  # noqa: B008 - frozen
        self._member = member
        self._count = HalfOpenCount(half_open)

    def call(self, sock: socket.socket, opening: Flavour) -> Stream:
        """Introduce this node over a connected socket; the peer is authenticated on return.

        Raises:
            ChannelError: the handshake failed; the socket is closed.
        """
        core = Connection.initiator(
            self._member.credentials, self._member.anchor.verify,
            random=secrets.token_bytes, now=now(), opening=opening, limits=DIALLED[opening],
            suites=self._member.suites,
        )  # fmt: skip
        stream = SecureSocket(sock, core)
        try:
            stream.settimeout(CONNECT_TIMEOUT)
            stream.do_handshake()
            stream.settimeout(None)
        except BaseException:
            stream.close()
            raise
        return stream

    def admit(self, address: str) -> bool:
        """Whether one more unfinished handshake from there is bearable; `answer` must follow."""
        return self._count.admit(address)

    def settle(self, address: str) -> None:
        """A caller that was admitted needs no handshake."""
        self._count.settle(address)

    def answer(self, sock: socket.socket, address: str, flavour: Flavour) -> Stream:
        """Answer a caller that was admitted; its handshake is still to come.

        Raises:
            OSError: it is gone already.
        """
        try:
            core = Connection.responder(
                self._member.credentials, self._member.anchor.verify,
                random=secrets.token_bytes, now=now(), accept={flavour}, limits=ACCEPTED[flavour],
                suites=self._member.suites,
            )  # fmt: skip
            sock.settimeout(None)  # rospy sets a default for all sockets of the process
            return SecureSocket(sock, core, lambda: self._count.settle(address))
        except BaseException:
            self._count.settle(address)  # a place that is not given back is lost for ever
            sock.close()
            raise
