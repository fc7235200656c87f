"""Confirmable messages until they are acknowledged (RFC 7252 section 4.2). Pure.

A reset has four octets and nobody's signature, so it counts as not delivered: the message is sent
again, and fails when nobody has acknowledged it after the last time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from rossec.border.timers import Timers

ACK_TIMEOUT: Final = 2.0  # seconds; longer by up to a half, at random
MAX_RETRANSMIT: Final = 4

Address = tuple[Any, ...]
Send = Callable[[bytes, Address], None]


@dataclass(slots=True)
class _Transmission:
    data: bytes
    failed: Callable[[], None]
    pause: float
    left: int
    timer: int


class Transmissions:
    """What was sent and is not acknowledged.

    Args:
        send: sends a datagram.
        timers: of all things.
        rand: a random number from 0 up to 1.
    """

    def __init__(self, send: Send, timers: Timers, rand: Callable[[], float]) -> None:
        self._send = send
        self._timers = timers
        self._rand = rand
        self._open: dict[tuple[Address, int], _Transmission] = {}

    def __len__(self) -> int:
        return len(self._open)

    def send(
        self, data: bytes, mid: int, address: Address, now: float, failed: Callable[[], None]
    ) -> None:
        """Send a confirmable message, again and again; `failed()` when nobody acknowledges it."""
        pause = ACK_TIMEOUT * (1 + self._rand() / 2)
        key = (address, mid)
        self.acknowledge(address, mid)
        timer = self._timers.at(now + pause, lambda at: self._again(key, at))
        self._open[key] = _Transmission(data, failed, pause, MAX_RETRANSMIT, timer)
        self._send(data, address)

    def acknowledge(self, address: Address, mid: int) -> None:
        """It arrived; a message that nobody waits for is ignored."""
        found = self._open.pop((address, mid), None)
        if found is not None:
            self._timers.cancel(found.timer)

    def _again(self, key: tuple[Address, int], now: float) -> None:
        found = self._open[key]
        if found.left == 0:
            del self._open[key]
            found.failed()
            return
        found.left -= 1
        found.pause *= 2
        found.timer = self._timers.at(now + found.pause, lambda at: self._again(key, at))
        self._send(found.data, key[0])
