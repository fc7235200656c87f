"""`docs/howto/two-sites.md`, typed as printed: homes behind NAT, routers in the open, all recorded.

The second test types it with links in clear, which shows what a router sees: TLS between relays and
routers hides from the network what is hidden from the routers too.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.typed import TypedShell, blocks_of, shells_of
from tests.support.wan import Wan, wan_of

PAGE: Final = ROOT / "docs" / "howto" / "two-sites.md"
SITES: Final = {"ada": ("ada", "kitchen"), "ben": ("ben",), "cottage": ("cottage",)}
ROUTERS: Final = ("router", "second")
NAMES: Final = (
    b"/robot/pose", b"/robot/camera", b"/robot\x00", b"/tablet", b"/cottage", b"/kitchen", b"/relay",
    b"/master", b"PoseStamped", b"std_msgs", b"home-of-ada", b"home-of-ben",
    b"front door", b"still warm",
)  # fmt: skip


@pytest.fixture
def wan() -> Iterator[Wan]:
    with wan_of(SITES, ROUTERS, delay_ms=5) as network:
        yield network


@pytest.fixture
def shells(wan: Wan, short_path: Path) -> Iterator[dict[str, TypedShell]]:
    opened = shells_of(wan.hosts, short_path)
    try:
        yield opened
    finally:
        for shell in opened.values():
            shell.close()


async def test_two_sites_work_as_printed(
    wan: Wan, shells: dict[str, TypedShell], tmp_path: Path
) -> None:
    async with wan.recorded(tmp_path / "capture") as found:
        for block in blocks_of(PAGE):
            shells[block.host].type(block.commands)
    (recording,) = found
    assert recording.dropped == 0
    assert shells["ben"].said.count("x: 3.0") == 2
    assert shells["kitchen"].said.count("data: still warm") == 2
    said = "".join(shell.said for shell in shells.values())
    assert "Traceback" not in said
    assert "x: 3.3" not in said
    assert [name for name in NAMES if recording.holds(name)] == []
