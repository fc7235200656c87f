"""`docs/howto/one-copy.md`, typed as printed: a gateway between a field and an office."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "one-copy.md"
LISTEN: Final = """
rossec topic echo field:/robot/says std_msgs/String --as /screen/window > heard 2> complaints &
until grep -q ripe heard; do sleep 0.1; done
"""
REVOKE: Final = "rossec ca revoke office:/gateway --certificate ~/stick/gateway.pem\n"


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    with lan_of({"field": ("field",), "office": ("office",)}) as lan:
        if not lan.real:
            pytest.skip("needs network namespaces")
        opened = shells_of(lan.hosts, short_path)
        try:
            yield opened
        finally:
            for shell in opened.values():
                shell.close()


@pytest.mark.timeout(300)
def test_one_copy_works_as_printed(shells: dict[str, TypedShell]) -> None:
    """Then the field revokes the gateway while a screen listens: it hears nothing more."""
    for block in blocks_of(PAGE):
        shells[block.host].type(block.commands)
    field, office = shells["field"], shells["office"]
    assert office.said.count("x: 3.0") == 2
    assert office.said.count("the wheat is ripe") == 2
    assert "field:/robot/pose (geometry_msgs/PoseStamped)" in office.said
    assert "from field: /robot/camera, 2 messages a second, the newest only" in office.said
    office.type(LISTEN)
    field.type(REVOKE)
    time.sleep(1)
    heard = (office.home / "heard").read_text().count("ripe")
    time.sleep(2)
    assert (office.home / "heard").read_text().count("ripe") == heard
    said = field.said + office.said
    assert "Traceback" not in said
    assert "x: 3.3" not in said
