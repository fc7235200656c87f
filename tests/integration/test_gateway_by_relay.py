"""The homes of `docs/howto/two-sites.md`, behind NAT with relays, and then a gateway in one."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_two_sites import PAGE, ROUTERS, SITES
from tests.support.typed import TypedShell, blocks_of, shells_of
from tests.support.wan import wan_of

PREPARE: Final = """
rossec node request /gateway --domain home-of-ben
rossec ca sign $ROSSEC_HOME/nodes/gateway/node.csr
rossec node install $ROSSEC_HOME/nodes/gateway/node.pem
cp $ROSSEC_HOME/nodes/gateway/node.pem ~/stick/gateway.pem
rossec grant sign /gateway --publish '/gateway/ada/**' --graph
rossec grant sign /robot --subscribe '/gateway/ada/**'
"""
ADMIT: Final = """
rossec domain limit ben --admit /tablet --admit /gateway
rossec grant sign ben:/gateway --certificate ~/stick/gateway.pem --subscribe /robot/pose \
    --type geometry_msgs/PoseStamped --round pose.position=2.0 --for 4h --out ~/stick/gateway.grant
"""
SERVE: Final = """
rossec grant install ~/stick/gateway.grant
rossec gateway --from ada /robot/pose &
rossec topic echo ada:/robot/pose geometry_msgs/PoseStamped --as /robot --count 2 | grep x:
"""


@pytest.fixture
def shells(short_path: Path) -> Iterator[dict[str, TypedShell]]:
    with wan_of(SITES, ROUTERS) as wan:
        opened = shells_of(wan.hosts, short_path)
        try:
            yield opened
        finally:
            for shell in opened.values():
                shell.close()


@pytest.mark.timeout(300)
def test_a_gateway_subscribes_through_the_relays(shells: dict[str, TypedShell]) -> None:
    """Ben's robot gets what the gateway may have: to two metres, where the tablet has one."""
    for block in itertools.takewhile(lambda each: each.host != "cottage", blocks_of(PAGE)):
        shells[block.host].type(block.commands)
    ben, ada = shells["ben"], shells["ada"]
    assert ben.said.count("x: 3.0") == 2
    ben.type(PREPARE)
    ada.type(ADMIT)
    ben.type(SERVE, within=90)
    assert ben.said.count("x: 4.0") == 2
    assert "Traceback" not in ben.said + ada.said
