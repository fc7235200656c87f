"""Restricted calls between rospy programs: a grant's rules for a request and a response."""

from pathlib import Path

import pytest

from grants.model import Restriction, Right, filter_rules
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.site import Site

pytestmark = pytest.mark.ros
LAMP = "/lamp/switch"

PROVIDER = (
    SECURE
    + """
import rospy
from std_srvs.srv import SetBool
rospy.init_node("lamp")
def switch(request):
    print("SWITCHED", request.data, flush=True)
    return True, "secret " + str(request.data)
rospy.Service("/lamp/switch", SetBool, switch)
print("READY", flush=True)
rospy.spin()
"""
)
CALLER = (
    SECURE
    + """
import rospy, sys
from std_srvs.srv import SetBool
rospy.init_node(sys.argv[1])
rospy.wait_for_service("/lamp/switch", timeout=20)
def attempt(proxy, on):
    try:
        answer = proxy(on)
        print("ANSWER", on, answer.success, repr(answer.message), flush=True)
    except rospy.ServiceException as error:
        print("FAILED", on, error, flush=True)
for persistent in False, True:
    proxy = rospy.ServiceProxy("/lamp/switch", SetBool, persistent=persistent)
    for on in False, True, False:
        attempt(proxy, on)
print("DONE", flush=True)
"""
)


def only(part: str, *conditions: str, **rules: str) -> Restriction:
    filters = filter_rules({field: {what: True} for field, what in rules.items()})
    return Restriction(f"std_srvs/SetBool{part}", conditions, filters)


async def answers(site: Site, directory: Path, name: str) -> list[str]:
    """The output of this caller: three single calls, three over a persistent connection."""
    async with program(environment(site, directory / name), CALLER, name) as caller:
        await caller.read_until("DONE")
        lines = caller.said.splitlines()
    assert "Traceback" not in caller.said
    return [line for line in lines if line.startswith(("ANSWER", "FAILED"))]


async def test_a_caller_sends_and_gets_what_its_grant_allows(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        entitle(site, "/lamp", {Right.PROVIDE: (LAMP,)})
        site.grant("/off", Right.CALL, LAMP, restriction=only("Request", "!msg.data"))
        site.grant("/dull", Right.CALL, LAMP, restriction=only("Response", message="clear"))
        async with program(environment(site, tmp_path / "lamp"), PROVIDER) as lamp:
            await lamp.read_until("READY")
            off = await answers(site, tmp_path, "off")
            dull = await answers(site, tmp_path, "dull")
            await lamp.read_until("refused /off")
            while lamp.said.count("SWITCHED") < 4 + 6:
                await lamp.read_until("SWITCHED")
    assert [line.split()[:3] for line in off] == 2 * [
        ["ANSWER", "False", "True"],
        ["FAILED", "True", "service"],
        ["ANSWER", "False", "True"],
    ]
    assert "the grant for /lamp/switch does not allow this request, or not now" in off[1]
    assert [line.split()[3] for line in dull] == 6 * ["''"]
    assert lamp.said.count("SWITCHED True") == 2, "what is refused does not reach the program"


async def test_a_caller_enforces_the_grant_of_its_provider(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        site.grant("/lamp", Right.PROVIDE, LAMP, restriction=only("Request", "!msg.data"))
        entitle(site, "/boss", {Right.CALL: (LAMP,)})
        async with program(environment(site, tmp_path / "lamp"), PROVIDER) as lamp:
            await lamp.read_until("READY")
            boss = await answers(site, tmp_path, "boss")
    assert [line.split()[:2] for line in boss] == 2 * [
        ["ANSWER", "False"],
        ["FAILED", "True"],
        ["ANSWER", "False"],
    ]
    assert "rossec: the grant for /lamp/switch does not allow this request" in boss[1]
