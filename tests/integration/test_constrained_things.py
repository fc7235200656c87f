"""`docs/howto/constrained-things.md`, typed as printed: a home, and a lamp on another host.

Then a fifth of the packets between the two is lost, the border router is killed, and at the end the
lamp is revoked: what it published is over within a second.
"""

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import Lan, lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "constrained-things.md"
EXAMPLES: Final = ROOT / "examples" / "border"
LISTEN: Final = """
rossec topic echo /kitchen/lamp/temperature sensor_msgs/Temperature --as /doctor > heard &
until grep -q temperature: heard; do sleep 0.1; done
"""
# RFC 7252 section 4.8.2: a request whose tries were all lost is given up after 93 s.
GIVEN_UP_TWICE: Final = 240.0  # seconds
HEAR_MORE: Final = """
heard=$(grep -c temperature: heard)
until test $(grep -c temperature: heard) -gt $((heard + 3)); do sleep 0.1; done
"""
# Where packets arrive: dropped where it is sent, one is an error of `sendmsg` (EPERM) instead.
LOSS: Final = """table inet lossy {
chain input {
    type filter hook input priority 0;
    iifname != "lo" meta l4proto udp numgen random mod 5 0 counter drop;
}
}"""
KILL: Final = """
kill -9 "%rossec border"
rossec border &
"""


@pytest.fixture
def lan() -> Iterator[Lan]:
    with lan_of({"house": ("home", "lamp")}) as network:
        if not network.real:
            pytest.skip("needs network namespaces")
        yield network


@pytest.fixture
def shells(lan: Lan, short_path: Path) -> Iterator[dict[str, TypedShell]]:
    opened = shells_of(lan.hosts, short_path)
    for program in EXAMPLES.glob("*.py"):
        shutil.copy(program, opened["lamp"].home)
    try:
        yield opened
    finally:
        for shell in opened.values():
            shell.close()


@pytest.mark.timeout(840)
def test_the_lamp_works_as_printed(lan: Lan, shells: dict[str, TypedShell]) -> None:
    *before, end = blocks_of(PAGE)
    for block in before:
        shells[block.host].type(block.commands)
    home = shells["home"]
    assert home.said.count("temperature: 20.0\n") + home.said.count("temperature: 20.0\r") >= 2
    home.type(LISTEN)
    with lossy(lan):
        home.type(HEAR_MORE, within=GIVEN_UP_TWICE)
        home.type(KILL)
        home.type(HEAR_MORE, within=GIVEN_UP_TWICE)
    home.type(HEAR_MORE, within=GIVEN_UP_TWICE)
    home.type(end.commands)
    time.sleep(1)
    heard = (home.home / "heard").read_text().count("temperature:")
    time.sleep(4)
    assert (home.home / "heard").read_text().count("temperature:") == heard
    said = "".join(shell.said for shell in shells.values())
    assert "Traceback" not in said + (shells["lamp"].home / "said").read_text()
    assert not (shells["lamp"].home / "stick" / "fan.secret").exists()


@contextlib.contextmanager
def lossy(lan: Lan) -> Iterator[None]:
    """Meanwhile a fifth of the UDP packets that reach the lamp or the home is lost."""
    for host in ("lamp", "home"):
        _nft(lan, host, LOSS)
    try:
        yield
    finally:
        for host in ("lamp", "home"):
            _nft(lan, host, "delete table inet lossy")


def _nft(lan: Lan, host: str, rules: str) -> None:
    environ = {**os.environ, "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
    subprocess.run(
        lan[host].at("nft", "-f", "-"), input=rules, text=True, check=True, capture_output=True, env=environ
    )
