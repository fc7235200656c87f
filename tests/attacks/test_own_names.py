"""Grants on the names of anonymous nodes: what they never give, in any spelling."""

import pytest

from ca.encoding import encode
from grants import document
from grants.errors import GrantMalformed, GrantNotHeld
from grants.model import ALL_RIGHTS, Permission, Right
from rossec.errors import ConfigurationError
from tests.support.attacker import (
    EVE,
    call,
    credentials,
    drafted,
    expect_refused,
    fields_for,
    listen,
    send_header,
    signed,
)
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness

OWN = "/eve~/**"
OTHERS = [
    "/robot/pose",
    "/robot/status",
    "/eve_/x",
    "/evex/x",
    "/eve1/x",
    "/x/eve_1/x",
    "/master/x",
    "/ca/x",
    "/eve_1",
    "/eve",
    "/eve_1/../robot/pose",
    "/robot//pose",
    "//robot/pose/",
    "/eve_1\u2215x",
    "/\u0435ve/x",
    "/eve~/x",
    "~/../x",
    "{node}/x",
    "x",
    "/remote/lab/eve_1/x",
    "lab:/eve_1/x",
    "/gateway/lab/eve_1/x",
    "/eve_1/%78",
]
# As ROS reads names; each is one of its own.
SPELLED = {"/eve//x": "/eve/x", "//eve/x": "/eve/x", "/eve_1/x/": "/eve_1/x", "~x": "/eve_1/x"}
pytestmark = pytest.mark.attack("tail-names")


@pytest.fixture
def eve(site: Site) -> Site:
    site.enroll(EVE, wildcard=True)
    return site


def everything(site: Site) -> bytes:
    return signed(site, permissions=(Permission(OWN, ALL_RIGHTS),))


async def test_at_the_master_no_name_but_its_own(eve: Site, witness: Witness) -> None:
    assert eve.master is not None
    uri, own = eve.master.uri, credentials(eve)
    await call(uri, own, "rossec.presentGrants", EVE, [everything(eve)])
    here = "http://127.0.0.1:1/"
    for name in OTHERS:
        for method, *params in (
            ("registerPublisher", name, POSE, here),
            ("registerSubscriber", name, POSE, here),
            ("registerService", name, "rosrpc://127.0.0.1:1", here),
            ("setParam", name, 1),
            ("getParam", name),
        ):
            answer = await call(uri, own, method, "/eve_1", *params)
            assert isinstance(answer, list), (name, method)
            assert answer[0] == -1, (name, method, answer)
    allowed = await call(uri, own, "setParam", "/eve_1", "/eve_1/x", 1)
    assert isinstance(allowed, list)
    assert allowed[0] == 1


async def test_another_spelling_of_its_own_name_is_its_own(eve: Site, witness: Witness) -> None:
    assert eve.master is not None
    uri, own = eve.master.uri, credentials(eve)
    await call(uri, own, "rossec.presentGrants", EVE, [everything(eve)])
    for name, meant in SPELLED.items():
        here = "http://127.0.0.1:1/"
        answer = await call(uri, own, "registerPublisher", "/eve_1", name, POSE, here)
        assert isinstance(answer, list)
        assert f"[{meant}]" in str(answer[1])


@pytest.mark.parametrize("name", [EVE, "/eve_1"])
async def test_a_grant_about_the_tail_of_another_node(
    eve: Site, witness: Witness, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    """Signed by mistake for Eve's key: its subject is the robot, and Eve has no certificate so."""
    listen(caplog)
    grant = signed(eve, subject="/robot", permissions=(Permission("/robot~/pose", Right(255)),))
    heard = await send_header(witness.topic_port, credentials(eve), fields_for(name, TOPIC, [grant]))
    expect_refused(heard, caplog, GrantNotHeld, "anonymous nodes of /robot")
    await witness.goes_on()


async def test_a_grant_about_a_tail_that_the_certificate_does_not_have(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    site.enroll(EVE)
    listen(caplog)
    grants = [everything(site)]
    fields = fields_for(EVE, TOPIC, grants)
    heard = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(heard, caplog, GrantNotHeld, f"anonymous nodes of {EVE}")
    assert site.master is not None
    answer = await call(site.master.uri, credentials(site), "rossec.presentGrants", EVE, grants)
    assert isinstance(answer, list)
    assert f"anonymous nodes of {EVE}" in str(answer)


async def test_the_tail_of_another_beside_its_own(
    eve: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """The authority's own key over claims that no authority signs."""
    with pytest.raises(GrantMalformed):
        drafted(eve, permissions=(Permission("/robot~/pose", Right.SUBSCRIBE),))
    claims = document.GRANT.peek(everything(eve))
    assert isinstance(claims, dict)
    listen(caplog)
    for pattern in ("/robot~/pose", "/robot_~/pose", "~/pose", "/*~/pose", "/eve~/../robot/pose"):
        forged = {**claims, 9: encode([[OWN, 255], [pattern, 255]])}
        grant = document.GRANT.sign(eve.authority.signer, forged)
        fields = fields_for(EVE, TOPIC, [grant])
        heard = await send_header(witness.topic_port, credentials(eve), fields)
        expect_refused(heard, caplog, GrantMalformed, "pattern")
    await witness.goes_on()


def test_the_authority_signs_no_tail_for_who_has_none(site: Site) -> None:
    site.enroll(EVE)
    draft = drafted(site, permissions=(Permission(OWN, Right.PUBLISH),))
    with pytest.raises(ConfigurationError, match="names of anonymous nodes"):
        site.authority.issue_grant(draft, site.now())
