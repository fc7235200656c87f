"""The subscriber's side of a topic: connected to a publisher for as long as the master names it."""

import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import rospy
from rospy.exceptions import TransportInitError

from ca.domains.aliases import shown
from grants.errors import GrantError
from rossec import clock
from rossec.inprocess.allow_plain import PlainConnection
from rossec.inprocess.genpy_types import max_message_size
from rossec.inprocess.identity import now
from rossec.inprocess.process import RosConnection, SecuredProcess
from rossec.inprocess.sockets import RosSocket
from rossec.ros.framing import Framing
from rossec.ros.header import FrameReader
from rossec.ros.settings import is_door, parse_uri

_FIRST_PAUSE: Final = 0.5
_LONGEST_PAUSE: Final = 30.0
_SLICE: Final = 0.5  # seconds between checks whether the subscriber is still in use


class SubscriptionLoop:
    """The subscriptions of one process."""

    def __init__(self, process: SecuredProcess) -> None:
        self._process = process

    def run(
        self, conn: Any, host: str, port: int, uri: str, callback: Callable[..., None], topic: str
    ) -> None:
        """`robust_connect_subscriber`: connected for as long as the master names the publisher.

        `host`, `port`: the publisher's answer, of no use at a relay's door, where its topics are.
        """
        if is_door(uri):
            host, port = parse_uri(uri)
        pause = _FIRST_PAUSE
        while not conn.done and not rospy.is_shutdown():
            before = conn.stat_num_msg
            self._receive_from(conn, host, port, uri, callback)
            if conn.protocol is None:  # closed, by the program or because the port is closed
                break
            self._close_socket(conn)
            if conn.stat_num_msg > before:
                pause = _FIRST_PAUSE
            if not self._wait_for_change(conn, pause, topic, uri):
                break
            pause = min(2 * pause, _LONGEST_PAUSE)
        if not conn.done:
            conn.close()

    def _receive_from(
        self, conn: Any, host: str, port: int, uri: str, callback: Callable[..., None]
    ) -> None:
        try:
            self._process.own_addresses.check_redirect(parse_uri(uri), (host, port))
            conn.connect(host, port, uri, timeout=60.0)
            self._receive(conn, callback)
        except TransportInitError:
            pass  # logged where it happened
        except Exception as error:  # noqa: BLE001 - as rospy: no message may end a subscription
            if not conn.done and not rospy.is_shutdown():
                self._process.reporter.warn(f"lost {conn.name} from {uri}", error)

    def _receive(self, conn: Any, callback: Callable[..., None]) -> None:
        """Messages until the connection ends; as `TCPROSTransport.receive_loop`."""
        sock, protocol = conn.socket, conn.protocol
        if sock is None or protocol is None:
            return
        framing = Framing(FrameReader(max_message_size(protocol.recv_data_class)))
        make, limit = protocol.recv_data_class, protocol.queue_size or 0
        while not conn.done and not rospy.is_shutdown():
            unit = sock.receive_before_deadline(framing, sock.stream.receive_unit)
            if not unit:
                return
            conn.stat_bytes += len(unit)
            received = self._filter(sock.connection, framing.feed(unit, now()))
            messages = [make().deserialize(data) for data in received[-limit:]]
            del unit, received  # their memory is used for the next one
            if not messages:
                continue
            conn.stat_num_msg += len(messages)
            for message in messages:
                message._connection_header = conn.header  # noqa: SLF001 - part of rospy's messages
            if conn.is_latched:
                conn.latch = messages[-1]
            callback(_until_aborted(messages, sock), conn)

    def _filter(
        self, connection: RosConnection | PlainConnection | None, messages: list[bytes]
    ) -> list[bytes]:
        """The messages as the publisher's right allows them."""
        guard = None if connection is None else connection.guard  # may be replaced meanwhile
        if connection is None or guard is None or isinstance(connection, PlainConnection):
            return messages
        filtered = []
        for message in messages:
            try:
                content = guard(message, clock.time())
            except GrantError as error:
                self._process.reporter.warn(
                    f"withheld a message on {shown(connection.decision.name)}", error
                )
            else:
                filtered += [] if content is None else [b"".join(content)]
        return filtered

    @staticmethod
    def _close_socket(conn: Any) -> None:
        sock, conn.socket = conn.socket, None
        if sock is not None:
            sock.close()

    def _wait_for_change(self, conn: Any, pause: float, topic: str, uri: str) -> bool:
        """Wait, at most `pause`, for a reason to try again; returns whether to."""
        end = time.monotonic() + pause
        membership = self._process.membership
        seen = membership.rights_version
        while seen == membership.rights_version and time.monotonic() < end:
            if conn.done or rospy.is_shutdown():
                return False
            time.sleep(min(_SLICE, max(0.0, end - time.monotonic())))
        return self._process.registrations.is_publisher(topic, uri)


def _until_aborted(messages: list[Any], sock: RosSocket) -> Iterator[Any]:
    """The messages of a batch, while the right to them lasts: callbacks may be slow."""
    return (message for message in messages if not sock.aborted)
