"""A slow line: two TAP devices, and every frame of one leaves by the other a fixed time later.

As a program (`python -m tests.support.slowline MILLISECONDS DEVICE DEVICE`), in the namespace that
is to have the devices; it says so once they are there. For kernels without netem.
"""

import fcntl
import heapq
import os
import select
import struct
import sys
import time
from typing import Final

_SET_INTERFACE: Final = 0x400454CA  # TUNSETIFF (linux/if_tun.h)
_TAP_WITHOUT_HEADER: Final = 0x0002 | 0x1000  # IFF_TAP | IFF_NO_PI
_LONGEST_FRAME: Final = 1 << 16
_MOST_WAITING: Final = 20_000  # frames; what is more is dropped, as by a router


def open_tap(name: str) -> int:
    """The descriptor of a new TAP device; it ends with this process."""
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _SET_INTERFACE, struct.pack("16sH22x", name.encode(), _TAP_WITHOUT_HEADER))
    return device


def carry(near: int, far: int, delay: float) -> None:
    """Carry frames between the two descriptors for ever, each `delay` seconds late."""
    waiting: list[tuple[float, int, int, bytes]] = []
    number = 0
    while True:
        pause = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for device in select.select([near, far], [], [], pause)[0]:
            while (frame := _read(device)) and len(waiting) < _MOST_WAITING:
                number += 1
                target = far if device == near else near
                heapq.heappush(waiting, (time.monotonic() + delay, number, target, frame))
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, target, frame = heapq.heappop(waiting)
            _write(target, frame)


def _read(device: int) -> bytes:
    try:
        return os.read(device, _LONGEST_FRAME)
    except OSError:  # nothing there, or the device is not up yet
        return b""


def _write(device: int, frame: bytes) -> None:
    try:
        os.write(device, frame)
    except OSError:  # a full or closed line drops, and tells nobody
        return


if __name__ == "__main__":
    taps = open_tap(sys.argv[2]), open_tap(sys.argv[3])
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    carry(*taps, float(sys.argv[1]) / 1000)
