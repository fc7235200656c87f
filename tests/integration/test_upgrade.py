"""`docs/howto/an-upgrade.md`, typed as printed: from a version of a few days ago."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import BIN, ROOT
from tests.support.lan import lan_of
from tests.support.oldversion import install_version
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "an-upgrade.md"
OLD: Final = "0471a5c5"  # of November 28, 2026


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    with lan_of({"site": ("site", "robot")}) as lan:
        if not lan.real:
            pytest.skip("NOT RUN: needs network namespaces")
        install_version(OLD, short_path / "old", short_path / "sources")
        opened = shells_of(lan.hosts, short_path)
        try:
            for shell in opened.values():
                (shell.home / "rossec").symlink_to(short_path / "old")
                (shell.home / "rossec-new").mkdir()
                (shell.home / "rossec-new" / "bin").symlink_to(BIN)
                shell.type("export PATH=~/rossec/bin:$PATH")
            yield opened
        finally:
            for shell in opened.values():
                shell.close()


def test_a_live_site_is_upgraded_and_goes_back_as_printed(shells: dict[str, TypedShell]) -> None:
    site, robot = shells["site"], shells["robot"]
    site.type(SITE)
    robot.type(ROBOT)
    site.type(GRANTS)
    robot.type("rossec topic pub /pose std_msgs/String --as /robot 'data: with the old version' &")
    heard = site.type("rossec topic echo /pose std_msgs/String --as /station --count 1")
    assert "with the old version" in heard
    site.said = ""
    *upgrade, back = blocks_of(PAGE)
    for block in upgrade:
        shells[block.host].type(block.commands)
    assert site.said.count("with the old version") == 2
    assert site.said.count("with the new version") == 2
    site.type(REVOKED)
    site.type(back.commands)
    assert site.said.count("with the new version") == 4
    site.type("! rossec ca list | grep /thief; rossec ca list | grep -q '^/robot '")
    assert "Traceback" not in site.said + robot.said


SITE: Final = """
export ROSSEC_HOME=~/site ROS_IP=10.98.0.1
export ROS_MASTER_URI=http://$ROS_IP:11311
rossec ca init site --master
rossec ca serve --locked &
rossec ca unlock --for 8h
rossec master --admin &
rossec ca invite '/**' --uses 3 > ~/stick/invitation
rossec node join --name /station < ~/stick/invitation
rossec node join --name /thief < ~/stick/invitation
"""
ROBOT: Final = """
export ROSSEC_HOME=~/robot ROS_IP=10.98.0.2
export ROS_MASTER_URI=http://10.98.0.1:11311
rossec node join --name /robot < ~/stick/invitation
"""
GRANTS: Final = """
rossec grant sign /robot --publish /pose
rossec grant sign /station --subscribe /pose
"""
# By the new version, after the backup.
REVOKED: Final = """
rossec ca revoke /thief
"""
