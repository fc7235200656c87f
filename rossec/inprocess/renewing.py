"""What is renewed on a connection of rospy's; on a plain one there is nothing to renew."""

from collections.abc import Callable

from ca.certificates import Identity
from rossec.channel.states import Renewal
from rossec.inprocess.connector import Stream
from rossec.inprocess.plain_stream import PlainStream
from rossec.net.threads.secure_socket import SecureSocket


class Renewing:
    """A socket over a connection, if it is connected."""

    _stream: Stream | PlainStream | None = None

    def on_renewal(self, callback: Callable[[Renewal[Identity]], None]) -> None:
        """As `SecureSocket`."""
        if isinstance(self._stream, SecureSocket):
            self._stream.on_renewal(callback)

    def present_grants(self, data: bytes) -> bool:
        """As `SecureSocket`."""
        return isinstance(self._stream, SecureSocket) and self._stream.present_grants(data)
