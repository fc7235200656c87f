"""`docs/howto/names-by-rules.md`, typed as printed on a host of its own."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]
PHONE: Final = "/smartphones/schneider/htc_desire"
TEMPERATURE: Final = "/building1/room3/sensors/temperature"
PAGE: Final = ROOT / "docs" / "howto" / "names-by-rules.md"


@pytest.fixture
def shell(short_path: Path) -> Iterator[TypedShell]:
    with lan_of({"site": ("home",)}) as lan:
        if not lan.real:
            pytest.skip("needs network namespaces")
        (opened,) = shells_of(lan.hosts, short_path).values()
        try:
            yield opened
        finally:
            opened.close()


def test_a_phone_is_named_as_printed(shell: TypedShell) -> None:
    said = [shell.type(block.commands, within=120) for block in blocks_of(PAGE)]
    for name in (f"{PHONE}\r\n", f"{PHONE}/sensors/accelerometer", TEMPERATURE):
        assert name in said[0]
    assert f"{PHONE} is enrolled until" in said[1]
    assert f'topicname: "{TEMPERATURE}"' in said[2]
    assert f"{PHONE}\r\n" in said[3]
    assert "warm" in said[3].rpartition(PHONE)[2]
    assert "Traceback" not in shell.said
