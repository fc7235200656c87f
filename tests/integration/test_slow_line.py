"""Two sites behind NAT and a slow line that loses packets and is cut: no connection is made anew.

Programs of every form at both; their messages come in order, none of them twice, none is missing.
"""

import contextlib
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import pytest

from tests.integration.foreignworld import LABEL, PAIRS, Cast, follow, pairs, prepare, running_programs, world
from tests.integration.sidecarworld import wait
from tests.support import relayprocess
from tests.support.wan import Wan, wan_of

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]
PORT: Final = 7447
DELAY: Final = 10  # ms between a site and the router, each way
CUT: Final = 10.0  # seconds
PAUSE: Final = 0.02  # between messages


@dataclass(frozen=True)
class Line:
    """The programs of both sites, and what is between."""

    cast: Cast
    wan: Wan

    def heard(self, source: str, sink: str) -> list[int]:
        """The numbers that a listener heard of a speaker, as they came."""
        said = self.cast.listeners[sink].said
        return list(map(int, re.findall(f"HEARD {LABEL}/{source} words {source} (\\d+)", said)))

    def count(self, about: str, source: str, sink: str) -> int:
        """How often a listener said so of a speaker."""
        return self.cast.listeners[sink].said.count(f"{about} {LABEL}/{source}")

    def goes_on(self) -> None:
        """Every listener hears every speaker, and calls it in either way."""
        before = [self.counts(*pair) for pair in PAIRS]
        wait(
            lambda: all(
                heard > first + 20 and called > second and kept > third
                for pair, (first, second, third) in zip(PAIRS, before, strict=True)
                for heard, called, kept in [self.counts(*pair)]
            )
        )

    def counts(self, source: str, sink: str) -> tuple[int, int, int]:
        """Messages heard, and calls over connections for each and over kept ones."""
        called, kept = (self.count(about, source, sink) for about in ("CALLED", "KEPT"))
        return len(self.heard(source, sink)), called, kept


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Line]:
    """What there is after the line was lossy, was cut for a while, and is whole again."""
    directory = tmp_path_factory.mktemp("slow_line")
    with (
        wan_of({"home": ("home",), "hospital": ("hospital",)}, ("router",), delay_ms=DELAY) as wan,
        contextlib.ExitStack() as stack,
    ):
        home, hospital = (world(directory, name, wan[name]) for name in ("home", "hospital"))
        for side in (home, hospital):
            relayprocess.seated(side, PORT, wan["router"])
        prepare(home, hospital)
        relayprocess.exchange(home, "home", hospital, "hospital")
        stack.enter_context(relayprocess.router(home, PORT, wan["router"]))
        for side, other in ((hospital, home), (home, hospital)):
            stack.enter_context(side.master(*follow(other, f"via: {other.site.anchor.domain}")))
            stack.enter_context(relayprocess.relay(side))
        cast = stack.enter_context(running_programs(home, hospital, directory / "never", PAUSE))
        line = Line(cast, wan)
        with wan.lossy(one_of=20):
            line.goes_on()
            with wan.without("home"):
                time.sleep(CUT)
            line.goes_on()
        yield line


@pairs
def test_messages_come_in_order_and_none_is_missing(line: Line, source: str, sink: str) -> None:
    heard = line.heard(source, sink)
    assert heard == list(range(heard[0], heard[0] + len(heard)))


@pairs
def test_no_topic_was_connected_anew(line: Line, source: str, sink: str) -> None:
    """Who connects anew gets the latched message again."""
    assert line.count("HEARD", source, sink) > 100
    assert line.count("HEARD", f"{source} latched", sink) == 1


@pairs
def test_no_call_over_a_kept_connection_failed(line: Line, source: str, sink: str) -> None:
    """A call that the cut met waits for its end."""
    assert line.count("NOT KEPT", source, sink) == 0
    assert line.count("KEPT", source, sink) >= 2
