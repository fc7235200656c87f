"""Makes the secure connections of one process, both ways; `sockets` adapts them to rospy."""

import socket
from functools import partial
from typing import Final
from weakref import WeakKeyDictionary

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.inprocess.identity import LocalIdentity
from rossec.net.halfopen import HalfOpenSlot
from rossec.net.threads.secure_socket import SecureSocket
from rossec.participant.own_addresses import Address, OwnAddresses

CONNECT_TIMEOUT: Final = 10.0

Stream = SecureSocket[Identity]


class Connector:
    """Makes the secure connections of one process, both ways."""

    def __init__(
        self, local_identity: LocalIdentity, own_addresses: OwnAddresses | None = None
    ) -> None:
        self._local_identity = local_identity
        self._own_addresses = OwnAddresses() if own_addresses is None else own_addresses
        self._slots: WeakKeyDictionary[socket.socket, HalfOpenSlot] = WeakKeyDictionary()

    def initiate(self, sock: socket.socket, protocol: WireProtocol, address: Address) -> Stream:
        """Handshake as the initiator over a socket that is connected to `address`.

        Raises:
            ChannelError: the handshake failed; the socket is closed.
        """
        return SecureSocket.initiate(
            sock,
            self._local_identity.context,
            protocol,
            to_itself=self._own_addresses.is_own(address),
            timeout=CONNECT_TIMEOUT,
        )

    def admit(self, sock: socket.socket, address: str) -> bool:
        """Whether one more half-open connection is within the limits.

        It counts until the peer is authenticated, or `sock` is closed.
        """
        slot = self._local_identity.context.half_open.admit(address)
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
            core = self._local_identity.context.responder(protocol)
            sock.settimeout(None)  # rospy sets a default for all sockets of the process
            return SecureSocket(sock, core, partial(self.release, sock))
        except BaseException:
            sock.close()
            self.release(sock)
            raise
