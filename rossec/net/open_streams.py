"""The open connections of one identity, on which its certificate is presented when it is renewed.

Thread-safe. They are held weakly: a connection that has ended needs no entry.
"""

from collections.abc import Sequence
from threading import Lock
from weakref import WeakSet

from rossec.channel.outbound import PresentsIdentity


class OpenStreams:
    """The open connections of one identity."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._streams: WeakSet[PresentsIdentity] = WeakSet()
        self._newest: Sequence[bytes] = ()

    def add(self, stream: PresentsIdentity) -> None:
        """A connection has begun; its handshake may have read the certificate before."""
        with self._lock:
            self._streams.add(stream)
            newest = self._newest
        if newest:
            stream.present_identity(newest)

    def present(self, chain: Sequence[bytes]) -> None:
        """The certificates of this identity are `chain` now: present them where they are new."""
        with self._lock:
            self._newest = chain
            streams = list(self._streams)
        for stream in streams:
            stream.present_identity(chain)
