"""A running program requests a right, and waits for the answer or goes on."""

from pathlib import Path

import pytest

from ca.errors import NameRefused, PatternRefused
from grants.model import Right
from grants.request import open_request
from rossec.errors import ConfigurationError
from rossec.inprocess import request
from rossec.inprocess.identity import LocalIdentity
from tests.support.fleet import environment, program
from tests.support.site import Site
from tests.support.victim import STATE, attacked

ASKER = """
import sys, rospy, rossec
rossec.secure()
from std_msgs.msg import String

def say(*words):
    # One write: two threads must not share a line.
    sys.stdout.write(" ".join(map(str, words)) + "\\n")
    sys.stdout.flush()

rospy.init_node("asker", anonymous=True)
words = rospy.Subscriber("/robot/state", String, lambda m: say("HEARD"))
say("HAS", rossec.ask("subscribe", "/robot/state", why="to look", wait=0.2))
say("HAS", rossec.ask("subscribe", "/robot/state", why="to look", wait=20))
try:
    rossec.ask("dance", "/x", why="")
except Exception as error:
    say("NO", error)
rospy.spin()
"""


@pytest.mark.ros
async def test_a_program_requests_a_grant_and_gets_it(tmp_path: Path) -> None:
    """Under an anonymous name: the identity is that for all such nodes."""
    async with attacked(tmp_path) as victim:
        site = victim.site
        site.enroll("/asker", wildcard=True)
        async with program(environment(site, tmp_path / "a"), ASKER) as asker:
            assert (await asker.read_until("HAS")) == "HAS False"
            requests = list((site.root / "nodes" / "asker" / "requests").iterdir())
            assert requests
            site.subscribe("/asker", STATE)
            assert (await asker.read_until("HAS")) == "HAS True"
            await asker.read_until("NO there is no right 'dance'")
            await asker.read_until("HEARD")
        await victim.goes_on()


class Process:
    def __init__(self, local_identity: LocalIdentity) -> None:
        self.local_identity = local_identity


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


@pytest.fixture
def process(site: Site, monkeypatch: pytest.MonkeyPatch) -> Process:
    found = Process(LocalIdentity(site.enroll("/robot"), "/robot"))
    monkeypatch.setattr(request, "secured", lambda: found)
    return found


def requests(site: Site, folder: str) -> list[bytes]:
    return [path.read_bytes() for path in (site.root / folder).glob("*.request")]


@pytest.mark.usefixtures("process")
def test_a_request_is_kept_for_an_authority_elsewhere(site: Site) -> None:
    assert not request.ask("param-get", "/robot/**", why="to look")
    (data,) = requests(site, "nodes/robot/requests")
    key = site.identity("/robot").public_key
    opened = open_request(data, key, domain="home", now=site.now())
    assert (opened.node, opened.why) == ("/robot", "to look")
    (wanted,) = opened.rights
    assert (wanted.right, wanted.pattern) == (Right.PARAM_GET, "/robot/**")


@pytest.mark.usefixtures("process")
def test_an_authority_of_this_home_gets_it_in_its_inbox(site: Site) -> None:
    (site.root / "ca").mkdir(mode=0o700)
    (site.root / "ca" / "ca.pem").write_bytes(b"there is one")
    assert not request.ask("publish", "/scan", why="")
    assert len(requests(site, "ca/inbox")) == 1
    assert requests(site, "nodes/robot/requests") == []


def test_a_right_that_is_held_is_not_requested(site: Site, process: Process) -> None:
    process.local_identity.access.hold(site.publish("/robot", "/scan"))
    assert request.ask("publish", "/scan", why="")
    assert requests(site, "nodes/robot/requests") == []


@pytest.mark.usefixtures("process")
def test_an_unknown_right_or_name_is_refused(site: Site) -> None:
    with pytest.raises(ConfigurationError, match="there is no right 'dance'") as caught:
        request.ask("dance", "/x", why="")
    assert "subscribe" in caught.value.hint
    with pytest.raises((PatternRefused, NameRefused)):
        request.ask("publish", "scan*", why="")
    assert requests(site, "nodes/robot/requests") == []


@pytest.mark.usefixtures("process")
def test_rights_on_names_of_other_domains_are_not_requested_here() -> None:
    with pytest.raises(ConfigurationError, match="hospital:/pose are given by the authority") as no:
        request.ask("subscribe", "/remote/hospital/pose", why="to look")
    assert "rossec grant sign LABEL:/" in no.value.hint
    assert "--subscribe /pose --certificate FILE" in no.value.hint
    assert no.value.hint.endswith("; or ask for /gateway/hospital/pose, if a gateway here serves it")
    with pytest.raises(ConfigurationError) as no:
        request.ask("call", "/remote/hospital/lamp", why="to switch it")
    assert "gateway" not in no.value.hint, "services go by none"
