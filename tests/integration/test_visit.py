"""`docs/howto/a-visit.md`, typed as printed on two hosts: a hospital's robot visits a home."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "a-visit.md"


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    with lan_of({"home": ("home",), "hospital": ("hospital",)}) as lan:
        if not lan.real:
            pytest.skip("needs network namespaces")
        opened = shells_of(lan.hosts, short_path)
        try:
            yield opened
        finally:
            for shell in opened.values():
                shell.close()


def test_the_visit_works_as_printed(shells: dict[str, TypedShell]) -> None:
    """Before its end the visitor begins to listen, and hears nothing more once it is over."""
    *visit, end = blocks_of(PAGE)
    for block in visit:
        shells[block.host].type(block.commands)
    home, hospital = shells["home"], shells["hospital"]
    assert hospital.said.count("x: 3.0") == 2
    hospital.type(LISTEN)
    home.type(end.commands)
    time.sleep(1)
    heard = (hospital.home / "heard").read_text().count("x: 3.0")
    assert heard
    time.sleep(2)
    assert (hospital.home / "heard").read_text().count("x: 3.0") == heard
    said = home.said + hospital.said
    assert "Traceback" not in said
    assert "x: 3.3" not in said


LISTEN: Final = """
rossec topic echo home:/robot/pose geometry_msgs/PoseStamped --as /rounds/robot3 > heard &
until grep -q x: heard; do sleep 0.1; done
"""
