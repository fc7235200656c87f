"""`docs/howto/two-robots-two-masters.md`, typed as printed on two hosts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "two-robots-two-masters.md"


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    with lan_of({"fleet": ("alpha", "beta")}) as lan:
        if not lan.real:
            pytest.skip("needs network namespaces")
        opened = shells_of(lan.hosts, short_path)
        try:
            yield opened
        finally:
            for shell in opened.values():
                shell.close()


def test_two_robots_work_as_printed(shells: dict[str, TypedShell]) -> None:
    for block in blocks_of(PAGE):
        shells[block.host].type(block.commands)
    beta = shells["beta"]
    assert beta.said.count('data: "at the door"') == 2
    assert "Traceback" not in "".join(shell.said for shell in shells.values())
