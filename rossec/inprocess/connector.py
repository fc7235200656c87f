"""Makes the secure connections of one process, both ways; `sockets` dresses them for rospy."""

import secrets
import socket
from functools import partial
from typing import Final
from weakref import WeakKeyDictionary

from ca.certificates import Identity
from rossec.channel.connection import Connection
from rossec.channel.opening import WireProtocol
from rossec.inprocess.identity import LocalIdentity, now
from rossec.net.bounds import ACCEPTED, DIALLED
from rossec.net.halfopen import HalfOpen, HalfOpenCount, HalfOpenSlot
from rossec.net.threads.secure_socket import SecureSocket
from rossec.participant.own_addresses import Address, OwnAddresses

CONNECT_TIMEOUT: Final = 10.0

Stream = SecureSocket[Identity]


class Connector:
    """Makes the secure connections of one process, both ways."""

    def __init__(
        self,
        member: LocalIdentity,
        half_open: HalfOpen = HalfOpen(),  # noqa: B008 - frozen
        own: OwnAddresses | None = None,
    ) -> None:
        self._member = member
        self._own = OwnAddresses() if own is None else own
        self._count = HalfOpenCount(half_open)
        self._places: WeakKeyDictionary[socket.socket, HalfOpenSlot] = WeakKeyDictionary()

    def call(self, sock: socket.socket, opening: WireProtocol, place: Address) -> Stream:
        """Introduce this node over a socket connected to `place`; returns once it is answered.

        Raises:
            ChannelError: the handshake failed; the socket is closed.
        """
        core = Connection.initiator(
            self._member.credentials, self._member.anchor.verify,
            random=secrets.token_bytes, now=now(), opening=opening, limits=DIALLED[opening],
            suites=self._member.suites, own_dials=self._own.own_dials_for(place),
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

    def admit(self, sock: socket.socket, address: str) -> bool:
        """Whether one more stranger is bearable: counted until it is proven, or `sock` is gone."""
        place = self._count.admit(address)
        if place is not None:
            place.bind(sock)
            self._places[sock] = place
        return place is not None

    def release(self, sock: socket.socket) -> None:
        """A caller that was admitted needs no handshake, or is gone."""
        place = self._places.pop(sock, None)
        if place is not None:
            place.release()

    def answer(self, sock: socket.socket, flavour: WireProtocol) -> Stream:
        """Answer a caller that was admitted; its handshake is still to come.

        Raises:
            OSError: it is gone already.
        """
        try:
            core = Connection.responder(
                self._member.credentials, self._member.anchor.verify,
                random=secrets.token_bytes, now=now(), accept={flavour}, limits=ACCEPTED[flavour],
                suites=self._member.suites, own_dials=self._own.dials,
            )  # fmt: skip
            sock.settimeout(None)  # rospy sets a default for all sockets of the process
            return SecureSocket(sock, core, partial(self.release, sock))
        except BaseException:
            sock.close()
            self.release(sock)
            raise
