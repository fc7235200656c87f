"""Both sides of the streams of a link, which keep the rules. The oracle is the bytes.

Nobody ever breaks a rule, and of each stream the bytes that arrive are those that were sent.
"""

from collections import deque

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from rossec.overlay.mux import (
    MAX_DATA,
    MOST,
    NODE,
    Data,
    Mux,
    OpeningRefused,
    Role,
    StreamOpened,
    StreamTarget,
)

ROBOT = StreamTarget(NODE, "/robot")


class BothSides(RuleBasedStateMachine):
    """Two sides that keep the rules, and a link between that delivers late, but in order."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.sides = {"caller": Mux(Role.CALLER), "called": Mux(Role.CALLED)}
        self.wire: dict[str, deque[bytes]] = {side: deque() for side in self.sides}
        self.sent: dict[tuple[str, int], bytearray] = {}
        self.got: dict[tuple[str, int], bytearray] = {}
        self.not_taken: dict[tuple[str, int], int] = {}
        self.opened = 0

    def put(self, side: str, unit: bytes) -> None:
        if unit:
            self.wire[side].append(unit)

    def deliver(self, side: str, other: str) -> None:
        """Deliver one unit that `other` sent."""
        for event in self.sides[side].receive(self.wire[other].popleft(), self.now):
            match event:
                case Data(stream, payload):
                    self.got.setdefault((other, stream), bytearray()).extend(payload)
                    key = side, stream
                    self.not_taken[key] = self.not_taken.get(key, 0) + len(payload)
                case StreamOpened(stream, _):
                    self.sides[side].connected(stream)
                case OpeningRefused():
                    pytest.fail("a caller that keeps the limits is refused")
                case _:
                    pass

    @precondition(lambda self: not self.sides["caller"].crowded(ROBOT, self.now))
    @rule()
    def open(self) -> None:
        _, unit = self.sides["caller"].open(ROBOT, self.now)
        self.put("caller", unit)
        self.opened += 1

    @precondition(lambda self: self.opened)
    @rule(side=st.sampled_from(["called", "caller"]), pick=st.integers(0), size=st.integers(1, MAX_DATA))
    def send(self, side: str, pick: int, size: int) -> None:
        stream = pick % self.opened
        mux = self.sides[side]
        size = min(size, mux.credit(stream))
        if stream in mux and size:
            payload = bytes((len(self.sent),)) * size
            self.put(side, mux.data(stream, size) + payload)
            self.sent.setdefault((side, stream), bytearray()).extend(payload)

    @precondition(lambda self: self.opened)
    @rule(
        side=st.sampled_from(["called", "caller"]),
        pick=st.integers(0),
        count=st.integers(1, MOST),
        round_trip_s=st.sampled_from([0.0, 0.1, 2.0]),
    )
    def take(self, side: str, pick: int, count: int, round_trip_s: float) -> None:
        key = side, pick % self.opened
        count = min(count, self.not_taken.get(key, 0))
        if count:
            self.not_taken[key] -= count
            self.put(side, self.sides[side].took(key[1], count, self.now, round_trip_s))

    @precondition(lambda self: self.opened)
    @rule(side=st.sampled_from(["called", "caller"]), pick=st.integers(0), broken=st.booleans())
    def finish(self, side: str, pick: int, broken: bool) -> None:
        mux = self.sides[side]
        stream = pick % self.opened
        self.put(side, mux.reset(stream) if broken else mux.end(stream))

    @rule(side=st.sampled_from(["called", "caller"]), count=st.integers(1, 20))
    def arrive(self, side: str, count: int) -> None:
        other = "caller" if side == "called" else "called"
        for _ in range(min(count, len(self.wire[other]))):
            self.deliver(side, other)

    @rule(seconds=st.floats(0, 4))
    def wait(self, seconds: float) -> None:
        """Less than what the caller waits longer: everything has arrived by then."""
        for side, other in (("called", "caller"), ("caller", "called")):
            while self.wire[other]:
                self.deliver(side, other)
        self.now += seconds

    @invariant()
    def bytes_arrive_in_order(self) -> None:
        for key, got in self.got.items():
            assert self.sent[key].startswith(got)

    @invariant()
    def no_side_holds_more_than_the_credit(self) -> None:
        assert all(count <= MOST for count in self.not_taken.values())

    def teardown(self) -> None:
        self.wait(0)
        self.wait(0)
        assert len(self.sides["caller"]) == len(self.sides["called"])


BothSides.TestCase.settings = settings(max_examples=60, stateful_step_count=60, deadline=None)
TestBothSides = BothSides.TestCase
