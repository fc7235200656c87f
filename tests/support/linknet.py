"""Two ends of a link and a network between that loses, repeats, reorders and is cut, with no clock.

Each end has bytes to send; what arrives is taken at once, unless the end is `slow`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Final

from rossec.overlay.link import Link
from rossec.overlay.link_frames import LinkFrameKind, head, kind_of

REPLY: Final = "rossec/1/open/" + 32 * "a"
ID: Final = bytes(range(16))
Fate = Callable[[float], tuple[float, ...]]
"""From the time a frame is put: after how long it arrives, each time it does."""


def frame(
    kind: LinkFrameKind, offset: int = 0, body: bytes = b"", link: bytes = ID, received: int = 0
) -> bytes:
    """A frame as anyone could make it."""
    return head(kind, link, offset, received, 65536) + body


@dataclass(slots=True)
class End:
    """One side: what it sent and received, what the octets on the way to it are."""

    name: str
    link: Link | None = None
    to_send: bytes = b""
    received: bytearray = field(default_factory=bytearray)
    untaken: int = 0
    slow: bool = False
    validates_at: int = 1  # bytes received, from which on the peer counts as authenticated
    octets_in: int = 0
    octets_out: int = 0
    kinds: list[LinkFrameKind] = field(default_factory=list)

    def at(self) -> Link:
        assert self.link is not None
        return self.link


class LinkNetwork:
    """The time, the frames on the way, and the two ends: `caller` and `called`."""

    def __init__(self, fate: Fate | None = None) -> None:
        self.now = 0.0
        self.fate = fate or (lambda _: (0.01,))
        self.cut = False
        self.rate = 0.0  # octets a second of a line, each way; 0: as many as one likes
        self._free_at = {"caller": 0.0, "called": 0.0}
        self.caller = End("caller", Link.open(ID, REPLY, 0.0))
        self.called = End("called")
        self._count = 0
        self._flying: list[tuple[float, int, End, bytes]] = []

    @property
    def ends(self) -> tuple[End, ...]:
        return tuple(end for end in (self.caller, self.called) if end.link is not None)

    def other(self, end: End) -> End:
        return self.called if end is self.caller else self.caller

    def write(self, end: End, data: bytes) -> None:
        end.at().write(data, self.now)
        end.to_send += data
        self.flush(end)

    def flush(self, end: End) -> None:
        for frame in end.at().frames_to_send(self.now):
            end.octets_out += len(frame)
            end.kinds.append(LinkFrameKind(kind_of(frame)))
            for delay in () if self.cut else self.fate(self.now):
                self._count += 1
                leaves = self._leave(end, len(frame))
                heappush(self._flying, (leaves + delay, self._count, self.other(end), frame))

    def _leave(self, end: End, octets: int) -> float:
        """When the last octet of a frame is on the line, after what waits before it."""
        if not self.rate:
            return self.now
        free = max(self.now, self._free_at[end.name]) + octets / self.rate
        self._free_at[end.name] = free
        return free

    def deliver(self, end: End, frame: bytes) -> None:
        if end.link is None:
            if kind_of(frame) != LinkFrameKind.OPEN:
                return
            end.link = Link.accept(frame, self.now)
        end.octets_in += len(frame)
        for piece in end.link.receive(frame, self.now):
            end.received += piece
            end.untaken += len(piece)
        if len(end.received) >= end.validates_at:
            end.link.validated()
        if not end.slow:
            self.take(end)
        self.flush(end)

    def take(self, end: End) -> None:
        count, end.untaken = end.untaken, 0
        end.at().consumed(count, self.now)

    def next_event(self) -> float | None:
        """When something happens next; None: never again."""
        times = [end.at().deadline() for end in self.ends]
        moments = [time for time in times if time is not None]
        moments += [self._flying[0][0]] if self._flying else []
        return min(moments, default=None)

    def step(self) -> bool:
        """Go on to the next event; false: there is none."""
        moment = self.next_event()
        if moment is None:
            return False
        self.now = max(self.now, moment)
        while self._flying and self._flying[0][0] <= self.now:
            _, _, end, frame = heappop(self._flying)
            self.deliver(end, frame)
        for end in self.ends:
            end.at().tick(self.now)
            self.flush(end)
        return True

    def run(self, until: Callable[[], bool], within: float = 60.0) -> float:
        """Go on until that holds; returns how many seconds it took."""
        begin = self.now
        while not until():
            assert self.step(), "nothing happens any more"
            assert self.now <= begin + within, "it takes too long"
        return self.now - begin

    def pass_time(self, seconds: float) -> None:
        """Let so much time pass."""
        end = self.now + seconds
        while (moment := self.next_event()) is not None and moment <= end:
            self.step()
        self.now = end

    def agreed(self) -> bool:
        """Whether each side has what the other one wrote."""
        return (
            bytes(self.called.received) == self.caller.to_send
            and bytes(self.caller.received) == self.called.to_send
        )

    def open(self) -> "LinkNetwork":
        """Both sides exchange a few bytes and authenticate each other."""
        self.write(self.caller, b"hello")
        self.run(lambda: self.called.link is not None)
        self.write(self.called, b"welcome")
        self.run(self.agreed)
        self.pass_time(0.1)
        return self


def opened() -> LinkNetwork:
    """Two ends that know each other, on a network that loses nothing."""
    return LinkNetwork().open()
