import time
from dataclasses import replace
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.revocation.lists import Timestamp, digest
from ca.revocation.trust_status import Revocations
from grants.errors import GrantMissing
from rossec.errors import ConnectionHeaderRefused
from rossec.participant import handshakes
from rossec.participant.access import Access
from rossec.participant.handshakes import Fields, TopicEndpoint
from rossec.participant.message_types import message_type
from tests.support.domains import alone
from tests.support.openaccess import OpenAccess
from tests.support.site import Site

NOW = int(time.time())
ENDPOINT = TopicEndpoint("/robot/pose", message_type("geometry_msgs/PoseStamped"))


class Pair:
    """A publisher and a subscriber that hold the grants they need."""

    def __init__(self, root: Path) -> None:
        site = Site(root, clock=lambda: NOW)
        site.publish("/robot", ENDPOINT.topic)
        site.subscribe("/viewer", ENDPOINT.topic)
        self.robot, self.viewer = site.identity("/robot"), site.identity("/viewer")
        self.robot_access = self._access(site, "/robot")
        self.viewer_access = self._access(site, "/viewer")

    def _access(self, site: Site, name: str) -> Access:
        held = Revocations(site.anchor.public_key)
        data = site.authority.store.newest_list()
        assert data is not None
        held.update(data, NOW)
        held.confirm(Timestamp(1, digest(data), NOW, 30), NOW)
        return Access(alone(site.anchor, held), site.enroll(name).grants())

    def request(self) -> Fields:
        return handshakes.subscriber_header("/viewer", ENDPOINT, self.viewer_access, NOW)

    def answer(self) -> Fields:
        return handshakes.publisher_header("/robot", ENDPOINT, self.robot_access, NOW, latching=False)

    def admit_viewer(self, fields: Fields, peer: Identity | None = None) -> None:
        handshakes.admit_subscriber(fields, peer or self.viewer, self.robot_access, NOW)

    def admit_robot(self, fields: Fields) -> None:
        handshakes.admit_publisher(fields, self.robot, ENDPOINT.topic, ENDPOINT.type, self.viewer_access, NOW)


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    return Pair(tmp_path / "site")


def test_the_two_headers_admit_each_other(pair: Pair) -> None:
    pair.admit_viewer(pair.request())
    pair.admit_robot(pair.answer())
    handshakes.check_type(pair.request(), ENDPOINT.topic, ENDPOINT.type)
    assert handshakes.requested_topic(pair.request()) == ENDPOINT.topic


def test_headers_hold_what_ros_expects(pair: Pair) -> None:
    assert pair.request() | {"rossec_grants": b""} == {
        "callerid": b"/viewer",
        "topic": b"/robot/pose",
        "type": b"geometry_msgs/PoseStamped",
        "md5sum": b"d3812c3cbc69362b77dc0b19b345f8f5",
        "message_definition": ENDPOINT.type.definition.encode(),
        "tcp_nodelay": b"1",
        "rossec_grants": b"",
    }
    assert pair.answer()["latching"] == b"0"
    latched = handshakes.publisher_header("/robot", ENDPOINT, pair.robot_access, NOW, latching=True)
    assert latched["latching"] == b"1"


def test_a_callerid_must_match_the_certificate_of_the_peer(pair: Pair) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="certified as /robot calls itself /viewer"):
        pair.admit_viewer(pair.request(), pair.robot)
    with pytest.raises(ConnectionHeaderRefused, match="calls itself"):
        pair.admit_robot(pair.answer() | {"callerid": b"/viewer"})


@pytest.mark.parametrize("key", ["callerid", "topic"])
@pytest.mark.parametrize(
    ("value", "said"), [(None, "has no"), (b"\xff\xfe", "is not text"), (b"/a\n/b", "control characters")]
)
def test_a_malformed_header_is_refused(pair: Pair, key: str, value: bytes | None, said: str) -> None:
    fields = pair.request()
    del fields[key]
    if value is not None:
        fields[key] = value
    with pytest.raises(ConnectionHeaderRefused, match=said):
        pair.admit_viewer(fields)


def test_a_subscriber_with_a_grant_for_another_topic_is_refused(pair: Pair) -> None:
    with pytest.raises(GrantMissing):
        pair.admit_viewer(pair.request() | {"topic": b"/robot/camera"})


def test_a_publisher_without_a_grant_is_refused(pair: Pair) -> None:
    fields = pair.answer()
    del fields["rossec_grants"]
    with pytest.raises(GrantMissing):
        pair.admit_robot(fields)


def test_an_answer_for_another_topic_is_refused(pair: Pair) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="another topic"):
        pair.admit_robot(pair.answer() | {"topic": b"/robot/camera"})


def test_an_error_of_the_publisher_is_quoted_on_one_line(pair: Pair) -> None:
    with pytest.raises(ConnectionHeaderRefused, match=r"^/robot refuses: no \[2J way$"):
        pair.admit_robot({"error": b"no\x1b[2J\nway"})
    with pytest.raises(ConnectionHeaderRefused, match="is not text"):
        pair.admit_robot({"error": b"\xff"})


@pytest.mark.parametrize(
    ("change", "fits"),
    [
        ({"type": b"*", "md5sum": b"*"}, True),
        ({"md5sum": b"*"}, True),
        ({"type": b"geometry_msgs/Pose"}, False),
        ({"md5sum": b"0" * 32}, False),
        ({"md5sum": b""}, False),
    ],
)
def test_types_are_compared_as_in_ros(pair: Pair, change: Fields, fits: bool) -> None:
    fields = pair.request() | change
    if fits:
        handshakes.check_type(fields, ENDPOINT.topic, ENDPOINT.type)
        return
    with pytest.raises(ConnectionHeaderRefused, match="the peer expects") as caught:
        handshakes.check_type(fields, ENDPOINT.topic, ENDPOINT.type)
    other = "name the type that the topic carries" if "type" in change else "same version"
    assert other in caught.value.hint


def test_an_anonymous_node_may_use_a_name_its_certificate_covers(pair: Pair) -> None:
    rviz = replace(pair.viewer, wildcard=True)
    pair.admit_viewer(pair.request() | {"callerid": b"/viewer_17"}, rviz)
    for name in (b"/robot", b"/master", b"/viewer_", b"/viewer_1/a"):
        with pytest.raises(ConnectionHeaderRefused, match="certified as /viewer calls itself"):
            pair.admit_viewer(pair.request() | {"callerid": name}, rviz)
    with pytest.raises(ConnectionHeaderRefused, match="calls itself"):
        pair.admit_viewer(pair.request() | {"callerid": b"/viewer_17"})


ALIAS = TopicEndpoint("/remote/hospital/robot/pose", ENDPOINT.type)


def test_the_header_for_an_alias_has_the_origins_name_and_access_the_alias(pair: Pair) -> None:
    access = OpenAccess()
    fields = handshakes.subscriber_header("/viewer", ALIAS, access, NOW)
    assert fields["topic"] == b"/robot/pose"
    assert access.presented == [("subscribe", ALIAS.topic)]
    hospital_robot = replace(pair.robot, name="/remote/hospital/robot", certified="/robot")
    handshakes.admit_publisher(pair.answer(), hospital_robot, ALIAS.topic, ALIAS.type, access, NOW)
    assert access.authorized == [("/remote/hospital/robot", "publish", ALIAS.topic)]


@pytest.mark.parametrize("topic", ["/remote/hospital/robot/pose", "/robot/other", "/remote"])
def test_a_publisher_answers_with_the_origins_name(pair: Pair, topic: str) -> None:
    answer = pair.answer() | {"topic": topic.encode()}
    with pytest.raises(ConnectionHeaderRefused, match="another topic than hospital:/robot/pose"):
        handshakes.admit_publisher(answer, pair.robot, ALIAS.topic, ALIAS.type, OpenAccess(), NOW)


def test_a_subscriber_that_asks_for_an_alias_is_refused(pair: Pair) -> None:
    access = OpenAccess()
    fields = pair.request() | {"topic": ALIAS.topic.encode()}
    with pytest.raises(ConnectionHeaderRefused, match="no name on the wire"):
        handshakes.admit_subscriber(fields, pair.viewer, access, NOW)
    assert access.authorized == []
