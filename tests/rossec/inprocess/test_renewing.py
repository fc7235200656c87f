"""What is presented on a connection of rospy's reaches the other end while nobody reads there."""

from typing import Any

from rossec.channel.negotiation import GrantsPresented
from rossec.inprocess.identity import LocalIdentity, Renewing
from rossec.inprocess.sockets import RosSocket
from tests.rossec.inprocess.socket_pair import connected


def test_grants_are_presented_and_heard(local_identity: LocalIdentity, listening: RosSocket) -> None:
    left, right = connected(local_identity, listening)
    heard: list[Any] = []
    right.on_renewal(heard.append)
    left.send_unit(b"x")
    assert right.recv(1) == b"x"
    assert left.present_grants(b"grants")
    for _ in range(100):
        right.run_timers()
        if heard:
            break
    assert heard == [GrantsPresented(b"grants")]
    for sock in (left, right):
        sock.close()


def test_a_socket_that_is_not_connected_has_nothing_to_renew() -> None:
    socket = Renewing()
    socket.on_renewal(lambda _: None)
    assert not socket.present_grants(b"grants")
