"""Makes the secure connections of one process, both ways; `sockets` adapts them to rospy."""

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
        local_identity: LocalIdentity,
        half_open: HalfOpen = HalfOpen(),  # noqa: B008 - frozen
        own_addresses: OwnAddresses | None = None,
    ) -> None:
        self._local_identity = local_identity
        self._own_addresses = OwnAddresses() if own_addresses is None else own_addresses
        self._half_open = HalfOpenCount(half_open)
        self._slots: WeakKeyDictionary[socket.socket, HalfOpenSlot] = WeakKeyDictionary()

    def initiate(self, sock: socket.socket, protocol: WireProtocol, address: Address) -> Stream:
        """Handshake as the initiator over a socket that is connected to `address`.

        Raises:
            ChannelError: the handshake failed; the socket is closed.
        """
        core = Connection.initiator(
            self._local_identity.credentials, self._local_identity.anchor.verify,
            random=secrets.token_bytes, now=now(), opening=protocol, limits=DIALLED[protocol],
            suites=self._local_identity.suites,
            own_dials=self._own_addresses.own_dials_for(address),
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
        """Whether one more half-open connection is within the limits.

        It counts until the peer is authenticated, or `sock` is closed.
        """
        slot = self._half_open.admit(address)
        if slot is not None:
            slot.bind(sock)
            self._slots[sock] = slot
        return slot is not None

    def release(self, sock: socket.socket) -> None:
        """Stop counting an admitted caller: it needs no handshake, or is gone."""
        slot = self._slots.pop(sock, None)
        if slot is not None:
            slot.release()

    def respond(self, sock: socket.socket, protocol: WireProtocol) -> Stream:
        """The responder's side for a caller that was admitted; the handshake is still to come.

        Raises:
            OSError: it is gone already.
        """
        try:
            core = Connection.responder(
                self._local_identity.credentials, self._local_identity.anchor.verify,
                random=secrets.token_bytes, now=now(), accept={protocol}, limits=ACCEPTED[protocol],
                suites=self._local_identity.suites, own_dials=self._own_addresses.dials,
            )  # fmt: skip
            sock.settimeout(None)  # rospy sets a default for all sockets of the process
            return SecureSocket(sock, core, partial(self.release, sock))
        except BaseException:
            sock.close()
            self.release(sock)
            raise
