"""What the programs of a measurement say to each other and to the benchmark. Pure.

A message is a `std_msgs/String` on the wire: a stamp of 16 bytes, which says the point and the
message, then as many bytes as the point has. Orders and answers are lines of JSON.
"""

import struct
from dataclasses import dataclass
from typing import Final

TYPE: Final = "std_msgs/String"
TOPIC: Final = "/talk"
_HEAD: Final = struct.Struct("<IQQ")  # length of the string, point, message


@dataclass(frozen=True)
class Point:
    """Messages of one size at one rate.

    Attributes:
        size: bytes of a message beside its stamp.
        rate: messages a second.
        count: how many of them.
    """

    size: int
    rate: float
    count: int

    @property
    def seconds(self) -> float:
        """How long they are sent."""
        return self.count / self.rate


def message(point: int, number: int, size: int) -> bytes:
    """A message as it is serialized, without its length prefix."""
    return _HEAD.pack(_HEAD.size - 4 + size, point, number) + bytes(size)


def stamp(data: bytes) -> tuple[int, int]:
    """Point and number of a message."""
    _, point, number = _HEAD.unpack_from(data)
    return point, number
