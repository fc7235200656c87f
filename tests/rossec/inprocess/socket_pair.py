"""Sockets as rospy gets them, with both ends in this process."""

import socket

from rossec.errors import ChannelError
from rossec.inprocess.identity import Connector, LocalIdentity
from rossec.inprocess.options import PlainPeers
from rossec.inprocess.sockets import RosSocket
from tests.support.secure_sockets import background


class Owner:
    """What a socket uses of its process."""

    def __init__(self, local_identity: LocalIdentity, plain: PlainPeers) -> None:
        self.connector = Connector(local_identity)
        self.plain = plain
        self.closed: list[RosSocket] = []
        self.ports: list[int] = []

    def listens(self, port: int) -> None:
        self.ports.append(port)

    def connection_closed(self, sock: RosSocket) -> None:
        self.closed.append(sock)

    def connect_error(self, address: tuple[str, int], error: ChannelError) -> Exception:
        return ConnectionError(f"{address[1] > 0} {error}")


def owner(local_identity: LocalIdentity, plain: PlainPeers | None = None) -> Owner:
    return Owner(local_identity, plain or PlainPeers(()))


def connected(
    local_identity: LocalIdentity, listening: RosSocket, family: int = socket.AF_INET
) -> tuple[RosSocket, RosSocket]:
    accepted: list[RosSocket] = []

    def accept() -> None:
        sock, _ = listening.accept()
        sock.handshake()
        accepted.append(sock)

    thread = background(accept)
    sock = RosSocket(owner(local_identity), socket.socket(family))
    sock.connect(listening.getsockname())
    thread.join(30)
    return sock, accepted[0]
