"""`docs/howto/a-policy-for-a-home.md`, typed as printed: nobody who does no wrong is refused."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.sidecarworld import Running, wait
from tests.integration.test_first_steps import ROOT
from tests.integration.test_quiet_programs import check_quiet
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of
from tests.support.xserver import x_server

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

PAGE: Final = ROOT / "docs" / "howto" / "a-policy-for-a-home.md"
POLICY: Final = re.compile(r"<<'END'\n(rossec: 1\n.*?)END\n", re.DOTALL)
RVIZ: Final = """
until rossec run --as /rviz -- rosnode list 2>&1 | grep -q '^/rviz_.*'; do sleep 0.3; done
"""


@pytest.fixture
def shell(short_path: Path) -> Iterator[TypedShell]:
    with lan_of({"home": ("home",)}) as lan:
        if not lan.real:
            assert not os.environ.get("CI"), "no network namespace: in CI there must be one"
            pytest.skip("NOT RUN: needs a network namespace, as the guide uses the usual ports")
        [opened] = shells_of(lan.hosts, short_path).values()
        try:
            yield opened
        finally:
            opened.close()


@pytest.fixture
def display() -> Iterator[str]:
    running = Running(x_server(), {})
    try:
        wait(lambda: running.said.strip().isdecimal())
        yield f":{running.said.strip()}"
    finally:
        running.close()


def test_the_policy_has_25_lines() -> None:
    [policy] = POLICY.findall(PAGE.read_text())
    assert len(policy.splitlines()) <= 25


def test_a_policy_for_a_home_works_as_printed(shell: TypedShell, display: str) -> None:
    shell.type(f"export DISPLAY={display} PYTHONWARNINGS=ignore")
    *works, asks = blocks_of(PAGE)
    for block in works:
        shell.type(block.commands)
    shell.type(RVIZ)
    said = shell.said
    assert "is right; rules: 5, basics, tests that hold: 1" in said
    assert "nothing to remark" in said
    assert "ALLOW: /heating" in said
    assert "DENY: /guest" in said
    assert (said.count("x: 3.3"), said.count("x: 4.0")) == (1, 1)
    assert shades(shell.home / "seen") == 2
    check_quiet(said)
    assert (shell.home / "denials").read_text() == ""
    assert '"name":"/robot/pose"' in shell.type(asks.commands).replace('": "', '":"')


def shades(seen: Path) -> int:
    """How many shades the pixels of the picture in `seen` have."""
    [data] = re.findall(r"(?m)^data: \[(.*)\]$", seen.read_text())
    return len({int(pixel) for pixel in data.split(",")})
