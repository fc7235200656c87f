"""A link over a network that loses, repeats, reorders and is cut. The oracle is the bytes.

Whatever happens, what a side received is a prefix of what the other one wrote; and once the network
works again, all of it arrives, soon.
"""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from rossec.overlay.link import AMPLIFICATION, LinkState
from tests.support.linknet import End, LinkNetwork

SIDES = st.sampled_from(["caller", "called"])
SIZES = st.sampled_from([1, 40, 1500, 20_000, 70_000, 300_000, 1_000_000])
FATES = st.lists(
    st.sampled_from([(0.01,), (0.01,), (0.01,), (), (0.01, 0.02), (0.05,), (0.001, 0.3)]),
    min_size=1,
    max_size=40,
)


class LossyLink(RuleBasedStateMachine):
    @initialize(fates=FATES, validates_at=st.sampled_from([1, 500]))
    def begin(self, fates: list[tuple[float, ...]], validates_at: int) -> None:
        self.fates = fates
        self.number = 0
        self.lossless = False
        self.network = LinkNetwork(self.fate)
        for end in (self.network.caller, self.network.called):
            end.validates_at = validates_at
        self.network.write(self.network.caller, self.content(500))
        self.network.pass_time(2.0)
        self.works()
        self.network.write(self.network.called, self.content(500))
        self.network.pass_time(2.0)
        self.works()

    def fate(self, _: float) -> tuple[float, ...]:
        self.number += 1
        return (0.01,) if self.lossless else self.fates[self.number % len(self.fates)]

    def content(self, size: int) -> bytes:
        self.number += 1
        return self.number.to_bytes(4) * (size // 4 + 1)

    def end(self, name: str) -> End | None:
        end = self.network.caller if name == "caller" else self.network.called
        return end if end.link is not None and end.link.state is not LinkState.DRAINING else None

    @rule(name=SIDES, size=SIZES)
    def write(self, name: str, size: int) -> None:
        end = self.end(name)
        if end is not None and end.at().writable:
            self.network.write(end, self.content(size))

    @rule(fates=FATES)
    def weather(self, fates: list[tuple[float, ...]]) -> None:
        self.fates = fates

    @rule(seconds=st.sampled_from([0.001, 0.02, 0.3, 2.0]))
    def wait(self, seconds: float) -> None:
        self.network.pass_time(seconds)
        self.works()  # no link lives for ever on what arrives once in a while

    @rule(seconds=st.sampled_from([0.1, 1.0, 8.0]))
    def partition(self, seconds: float) -> None:
        self.network.cut = True
        self.network.pass_time(seconds)
        self.network.cut = False
        self.works()

    def works(self) -> None:
        """A while without losses, in which there is progress."""
        self.lossless = True
        self.network.pass_time(2.0)
        self.lossless = False

    @rule(name=SIDES)
    def stop_reading(self, name: str) -> None:
        end = self.end(name)
        if end is not None:
            end.slow = True

    @rule(name=SIDES)
    def read_on(self, name: str) -> None:
        end = self.end(name)
        if end is not None:
            self.resume(end)

    def resume(self, end: End) -> None:
        end.slow = False
        self.network.take(end)
        self.network.flush(end)

    @invariant()
    def nothing_is_invented(self) -> None:
        network = self.network
        for end in (network.caller, network.called):
            sent = network.other(end).to_send
            assert sent.startswith(bytes(end.received))
        called = network.called
        if len(called.received) < called.validates_at:
            assert called.octets_out <= AMPLIFICATION * called.octets_in

    def teardown(self) -> None:
        network = self.network
        self.lossless = True
        for end in network.ends:
            self.resume(end)
        network.run(network.agreed)
        for end in network.ends:
            end.at().finish(network.now)
            network.flush(end)
        done = LinkState.DONE
        network.run(lambda: all(end.at().state is done for end in network.ends), within=20)
        assert network.agreed()


TestLossyLink = LossyLink.TestCase
TestLossyLink.settings = settings(max_examples=150, stateful_step_count=25, deadline=None)
