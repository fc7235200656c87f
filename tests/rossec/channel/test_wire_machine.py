"""Two connections joined by a wire that drops, repeats, reorders, flips and truncates.

Whatever the wire does, each side has delivered a prefix of the units the other one sent; and once
the wire has lied, the side that noticed is closed for good.
"""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from rossec.channel.negotiation import ConnectionState
from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelError
from tests.support.wire import NOW, End, alice, bob, receive, wire

LIMITS = ChannelLimits(records=5, octets=1 << 20, seconds=1 << 30)
SIDES = st.sampled_from(["left", "right"])
SIZES = st.sampled_from([1, 2, 100, 40_000, 300_000])


class TwoConnections(RuleBasedStateMachine):
    @initialize()
    def begin(self) -> None:
        w = wire(alice(limits=LIMITS), bob(limits=LIMITS))
        self.ends = {"left": w.left, "right": w.right}
        self.flying: dict[str, list[bytes]] = {"left": [], "right": []}  # by sender
        self.sent: dict[str, list[bytes]] = {"left": [], "right": []}
        self.lied: set[str] = set()  # about what this sender sent
        self.count = 0

    def other(self, side: str) -> str:
        return "right" if side == "left" else "left"

    def collect(self) -> None:
        for side, end in self.ends.items():
            data = end.take()
            if data:
                self.flying[side].append(data)

    @rule(side=SIDES, size=SIZES)
    def send(self, side: str, size: int) -> None:
        self.collect()
        unit = self.count.to_bytes(4) * (size // 4 + 1)
        self.count += 1
        try:
            self.ends[side].core.send_unit(unit)
        except ChannelError:
            return
        self.sent[side].append(unit)
        self.collect()

    @rule(side=SIDES, step=st.sampled_from([0, 1000, 33_333]))
    def carry(self, side: str, step: int) -> None:
        self.collect()
        if self.flying[side]:
            self.ends[self.other(side)].give(self.flying[side].pop(0), step)
            self.collect()

    @rule(side=SIDES)
    def carry_everything(self, side: str) -> None:
        for _ in range(len(self.flying[side]) + 1):
            self.carry(side, 0)

    @rule(side=SIDES, what=st.sampled_from(["drop", "repeat", "swap", "cut", "flip"]), at=st.floats(0, 0.999))
    @precondition(lambda self: any(self.flying.values()))
    def lie(self, side: str, what: str, at: float) -> None:
        flying = self.flying[side]
        if not flying or (what == "swap" and len(flying) < 2):
            return
        first, place = flying[0], int(at * len(flying[0]))
        if what == "drop":
            flying.pop(0)
        elif what == "repeat":
            flying.insert(0, first)
        elif what == "swap":
            flying[0], flying[1] = flying[1], flying[0]
        elif what == "cut":
            flying[0] = first[:place]
        elif first:  # a cut may have left nothing
            flying[0] = first[:place] + bytes([first[place] ^ 1]) + first[place + 1 :]
        self.lied.add(side)

    @rule(side=SIDES)
    def close(self, side: str) -> None:
        self.collect()
        self.ends[side].core.close()
        self.collect()

    @rule(side=SIDES)
    def end_of_stream(self, side: str) -> None:
        """The wire ends; nothing of this sender arrives any more."""
        self.flying[side].clear()
        self.lied.add(side)
        end: End = self.ends[self.other(side)]
        try:
            end.core.receive_eof()
        except ChannelError as error:
            end.error = end.error or error
        assert end.core.state is ConnectionState.CLOSED

    @invariant()
    def nothing_but_a_prefix_is_delivered(self) -> None:
        for side in self.ends:
            got = self.ends[self.other(side)].units
            assert got == self.sent[side][: len(got)]

    @invariant()
    def who_failed_stays_closed(self) -> None:
        for end in self.ends.values():
            if end.error is not None:
                assert end.core.state is ConnectionState.CLOSED
                assert receive(end.core, b"\x40\0\0\x11" + bytes(17), NOW) == []

    @invariant()
    def an_honest_wire_breaks_nothing(self) -> None:
        if not self.lied:
            for end in self.ends.values():
                assert end.error is None, end.error


TwoConnections.TestCase.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
TestTwoConnections = TwoConnections.TestCase
