"""`docs/howto/authority-lost-or-stolen.md`, typed as printed: host lost, then the key stolen."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.lan import lan_of
from tests.support.typed import TypedShell, blocks_of, shells_of

PAGE: Final = ROOT / "docs" / "howto" / "authority-lost-or-stolen.md"


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    """`new` is another machine with the address of `site`."""
    with lan_of({"site": ("site", "robot", "clean")}) as lan:
        if not lan.real:
            pytest.skip("NOT RUN: needs network namespaces")
        opened = shells_of({**lan.hosts, "new": lan["site"]}, short_path)
        try:
            yield opened
        finally:
            for name in opened.keys() - {"site"}:  # that was lost
                opened[name].close()


@pytest.mark.timeout(400)
def test_both_work_as_printed(shells: dict[str, TypedShell]) -> None:
    robot, new = shells["robot"], shells["new"]
    blocks = blocks_of(PAGE)
    first_new = next(at for at, block in enumerate(blocks) if block.host == "new")
    for at, block in enumerate(blocks):
        if at == first_new:
            shells["site"].close()
            new.type(WITHOUT_LIST)
        if at == first_new + 2:
            new.type(STAYS_OUT)
        if block.host == "clean" and "grant sign" in block.commands:
            robot.type(KEPT_OUT)
        shells[block.host].type(block.commands)
    assert "1 revocations newer than the backup were taken over" in new.said
    assert robot.said.count('data: "here"') == 3
    assert robot.said.count('data: "here again"') == 2
    new.type(BY_THE_THIEF)
    assert "here again" not in new.said
    assert "Traceback" not in "".join(shell.said for shell in shells.values())


# Before the block of the new host: what it says without a list, and that it writes nothing.
WITHOUT_LIST: Final = """
export ROSSEC_HOME=~/site
! rossec ca restore ~/stick/site.backup 2> refused
grep -q 'revoked after the backup would be valid again' refused
grep -q "scp 'HOST:ROSSEC_HOME/nodes/master/revocations" refused
[ -z "$(ls -A $ROSSEC_HOME)" ]
"""
STAYS_OUT: Final = """
! rossec ca list | grep /thief
rossec ca list | grep -q '^/robot '
rossec ca list | grep -q '^/station '
"""
# A robot that was not told to trust another root, after it was.
KEPT_OUT: Final = """
export ROSSEC_HOME=~/other
mkdir -m 700 ~/other ~/other/nodes
cp -r ~/untrusted/robot ~/other/nodes/
! rossec node join --name /robot < ~/stick/invitation2 2> other.err
grep -q 'trusts another authority already' other.err
export ROSSEC_HOME=~/robot
"""
# With the old root, whose key signs what it likes.
BY_THE_THIEF: Final = """
export ROS_MASTER_URI=http://10.98.0.3:11311
rossec node request /station2 --domain site
rossec ca sign $ROSSEC_HOME/nodes/station2/node.csr
rossec node install $ROSSEC_HOME/nodes/station2/node.pem
rossec grant sign /station2 --subscribe /pose || true
! rossec topic echo /pose std_msgs/String --as /station2 --count 1
! rossec ca publish
"""
