from dataclasses import replace

import pytest

from ca.certificates import Identity
from ca.errors import NameRefused
from rossec.errors import ConfigurationError, ConnectionHeaderRefused
from rossec.participant import handshakes
from tests.support.pki import NOW, Site

POSE, ALIAS = "/robot/pose", "/remote/hospital/robot/pose"
PUBLISHER = "http://10.0.0.7:6000/"
INFORMATION = {"getName": "/robot", "getUri": PUBLISHER, "getPid": 7}


@pytest.fixture(scope="module")
def own() -> Identity:
    site = Site.create()
    return site.anchor.verify([site.leaf("/robot")], NOW)


@pytest.fixture(scope="module")
def foreigner(own: Identity) -> Identity:
    return replace(own, domain="hospital", name="/remote/hospital/robot", certified="/robot")


def test_nothing_is_offered_below_remote() -> None:
    assert handshakes.refuse_offer(POSE, "published") == POSE
    with pytest.raises(ConfigurationError, match=f"^{ALIAS} cannot be published here") as caught:
        handshakes.refuse_offer(ALIAS, "published")
    assert "the others see it below /remote/LABEL" in caught.value.hint


@pytest.mark.parametrize("method", sorted(handshakes.OFFERS))
def test_a_programs_call_that_offers_below_remote_is_answered_with_the_reason(method: str) -> None:
    for name in (ALIAS, "/remote"):
        refusal = handshakes.offer_refusal(method, ("/robot", name, "more"))
        assert refusal is not None
        code, status, _ = refusal
        assert code == -1
        assert str(status).startswith(f"rossec: {name} cannot be {handshakes.OFFERS[method]}")
        assert "take a name outside /remote" in str(status)
    for params in ((), ("/robot",), ("/robot", 7), ("/robot", POSE), ("/robot", "/remotely/a")):
        assert handshakes.offer_refusal(method, params) is None


@pytest.mark.parametrize("method", ["registerSubscriber", "getParam", "unregisterPublisher"])
def test_what_is_only_read_may_be_below_remote(method: str) -> None:
    assert handshakes.offer_refusal(method, ("/robot", ALIAS)) is None


def test_a_header_on_the_wire_has_the_origins_name() -> None:
    fields = {"callerid": b"/viewer", "topic": ALIAS.encode(), "md5sum": b"*"}
    assert handshakes.fields_on_wire(fields) == fields | {"topic": POSE.encode()}
    service = {"service": b"/remote/hospital/lamp"}
    assert handshakes.fields_on_wire(service) == {"service": b"/lamp"}
    own = {"topic": POSE.encode(), "service": b"/lamp"}
    assert handshakes.fields_on_wire(own) == own
    with pytest.raises(NameRefused):
        handshakes.fields_on_wire({"topic": b"/remote/hospital"})
    with pytest.raises(ConnectionHeaderRefused):
        handshakes.fields_on_wire({"topic": b"\xff"})


def test_a_header_for_a_program_has_local_names(own: Identity, foreigner: Identity) -> None:
    fields = {"callerid": b"/robot", "topic": POSE.encode(), "md5sum": b"*"}
    local = {"callerid": foreigner.name.encode(), "topic": ALIAS.encode()}
    assert handshakes.fields_here(fields, foreigner, ALIAS) == fields | local
    assert handshakes.fields_here(fields, own, POSE) == fields
    assert handshakes.fields_here(fields, own) == fields
    assert handshakes.fields_here({"md5sum": b"*"}, foreigner, ALIAS) == {"md5sum": b"*"}


def test_a_program_knows_a_foreign_caller_by_its_alias(own: Identity, foreigner: Identity) -> None:
    assert handshakes.caller_here(foreigner, "/robot") == "/remote/hospital/robot"
    assert handshakes.caller_here(own, "/robot_17") == "/robot_17"


def test_a_foreigner_gets_the_certified_name_without_a_tail(own: Identity, foreigner: Identity) -> None:
    assert handshakes.caller_for(own, "/rviz_1", "/rviz") == "/rviz_1"
    assert handshakes.caller_for(foreigner, "/rviz_1", "/rviz") == "/rviz"


def test_what_a_foreign_node_says_of_itself_is_read_in_local_names(foreigner: Identity) -> None:
    def here(method: str, value: object) -> object:
        return handshakes.answer_here(foreigner, "home", method, value)

    assert here("getName", "/robot") == "/remote/hospital/robot"
    assert here("getPublications", [[POSE, "p/T"], ["/remote/home/x", "p/T"], ["a b", "p/T"]]) == [
        [ALIAS, "p/T"]
    ]
    rows = [
        [1, PUBLISHER, "i", "TCPROS", "/plan", True],
        [2, "/display", "o", "TCPROS", POSE, True, "more"],
        [3, "/remote/home/viewer", "o", "TCPROS", POSE, True],
        [4, PUBLISHER, "i", "TCPROS", "/remote/home/x", True],
        [5, "home:/viewer", "o", "TCPROS", POSE, True],
        [6, PUBLISHER, "i", "TCPROS", "home:/word", True],
        [7, "home:/remote/clinic/x", "o", "TCPROS", POSE, True],
        [8, "clinic:/viewer", "o", "TCPROS", POSE, True],
        "malformed",
    ]
    assert here("getBusInfo", rows) == [
        [1, PUBLISHER, "i", "TCPROS", "/remote/hospital/plan", True],
        [2, "/remote/hospital/display", "o", "TCPROS", ALIAS, True, "more"],
        [5, "/viewer", "o", "TCPROS", ALIAS, True],
        [6, PUBLISHER, "i", "TCPROS", "/word", True],
    ]


def test_a_foreign_node_is_told_no_names_of_third_domains(own: Identity, foreigner: Identity) -> None:
    rows = [[POSE, "p/T"], [ALIAS, "p/T"], ["/remote/clinic/x", "p/T"], ["malformed"]]
    assert handshakes.answer_for(foreigner, "getSubscriptions", rows) == [
        [POSE, "p/T"],
        [f"hospital:{POSE}", "p/T"],
    ]
    assert handshakes.answer_for(own, "getSubscriptions", rows) == rows
    stats = [[[ALIAS, 7, []]], [], []]
    assert handshakes.answer_for(foreigner, "getBusStats", stats) == [[], [], []]
    assert handshakes.answer_for(own, "getBusStats", stats) == [[], [], []]
    connections = [
        [1, "/viewer", "o", "TCPROS", POSE, True],
        [2, "/remote/clinic/robot", "o", "TCPROS", POSE, True],
    ]
    assert handshakes.answer_for(foreigner, "getBusInfo", connections) == connections[:1]


@pytest.mark.parametrize(("method", "value"), sorted(INFORMATION.items()))
def test_other_answers_are_as_they_are(own: Identity, method: str, value: object) -> None:
    assert handshakes.answer_here(own, "home", method, value) == value
    assert handshakes.answer_for(own, method, value) == value


@pytest.mark.parametrize(
    ("method", "empty"),
    [("getBusInfo", []), ("getName", ""), ("getPublications", []), ("getSubscriptions", [])],
)
def test_a_malformed_answer_of_a_foreign_node_is_empty(
    foreigner: Identity, method: str, empty: object
) -> None:
    for value in (7, {"a": 1}, None):
        assert handshakes.answer_here(foreigner, "home", method, value) == empty
    assert handshakes.answer_here(foreigner, "home", "getName", "/remote/home/x") == ""
    assert handshakes.answer_here(foreigner, "home", "getPid", 7) == 7
