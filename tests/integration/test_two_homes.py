"""`docs/howto/root-and-master-on-two-hosts.md`, typed as printed on two hosts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "root-and-master-on-two-hosts.md"


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    with lan_of({"site": ("authority", "master")}) as lan:
        if not lan.real:
            pytest.skip("NOT RUN: needs network namespaces")
        opened = shells_of(lan.hosts, short_path)
        try:
            yield opened
        finally:
            for shell in opened.values():
                shell.close()


def test_it_works_as_printed(shells: dict[str, TypedShell]) -> None:
    authority, master = shells["authority"], shells["master"]
    for block in blocks_of(PAGE):
        shells[block.host].type(block.commands)
    assert authority.said.count("the master has the grant, and gives it to the node") == 2
    assert authority.said.count("  waiting") == 2
    assert authority.said.count("  held") == 2
    assert master.said.count('data: "here"') == 2
    assert "the master has the new list" in authority.said
    master.type("until ! rossec topic list --as /robot >/dev/null 2>&1; do sleep 0.2; done")
    assert not (master.home / "master" / "ca").exists()
    assert not (authority.home / "authority" / "nodes").exists()
    assert "Traceback" not in authority.said + master.said
