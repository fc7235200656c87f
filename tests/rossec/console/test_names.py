"""What the policy calls things, and that a page never shows a title alone."""

import re

import pytest

from grants.policy.privacy import ReceiverAccess
from rossec.authority.console.messages import GrantQuestion, PolicyName
from rossec.console.matrix import topics
from rossec.console.pages.visibility import write
from rossec.console.words import NONE, Names
from rossec.errors import KeyServiceRefused
from rossec.participant.host_types import layout_of
from tests.support.consolehome import NOW, POSE, as_service, demo
from tests.support.consolepages import Browser

DOCTOR = "Dr. Meier"
PLACE = "where the robot is"
FOUND = [
    PolicyName("/doctor", DOCTOR, ""),
    PolicyName("/robot/pose", PLACE, POSE),
    PolicyName("/remote/hospital/rounds/one", "Ward 3", ""),
    PolicyName("/robots/**", "", "sensor_msgs/LaserScan"),
]


def test_a_title_is_found_by_the_name_and_as_it_is_shown() -> None:
    names = Names.of(FOUND)
    assert names.title("/doctor") == DOCTOR
    assert names.title("hospital:/rounds/one") == "Ward 3"
    assert names.title("/heating") == NONE.title("/doctor") == ""
    assert names.type_of("/robot/pose") == POSE
    assert names.type_of("/robots/one/scan") == "sensor_msgs/LaserScan"
    assert names.type_of("/other") == ""


def test_a_title_is_bounded_and_printable_whatever_the_service_says() -> None:
    title = Names.of([PolicyName("/a", "\u202e" + "x" * 999, "")]).title("/a")
    assert "\u202e" not in title
    assert len(title) < 80


def page(path: str) -> str:
    made = Browser(as_service(demo()))
    made.now = NOW
    made.home.names = [*FOUND, PolicyName("/heating", "<b>Dr. Meier</b>", "")]
    return str(made.log_in().get(path).text)


@pytest.mark.parametrize("path", ["/", "/who", "/way", "/log", "/see/robot/pose", "/node/doctor", "/privacy"])
def test_every_page_shows_titles_with_the_name_beside_them(path: str) -> None:
    text = page(path)
    titled = re.findall(r'<b class="title"><bdi>([^<]*)</bdi></b> (<[^>]*>(?:<bdi>)?)([^<]*)<', text)
    assert len(titled) == text.count('class="title"'), "a title without its name"
    assert DOCTOR in {title for title, *_ in titled}
    for title, tag, name in titled:
        assert 'class="name"' in tag
        assert {DOCTOR: "/doctor", PLACE: "/robot/pose"}.get(title, "/heating") == name
    assert "<b>Dr. Meier</b>" not in text
    assert ("&lt;b&gt;Dr. Meier" in text) is (path != "/node/doctor")


def test_the_picture_of_the_flow_has_both() -> None:
    text = page("/way")
    assert 'class="box-title" text-anchor="middle">Dr. Meier</text>' in text.replace("'", '"')
    assert ">/doctor</text>" in text


def test_the_report_as_a_file_has_titles() -> None:
    found = topics([ReceiverAccess("/robot/pose", POSE, "/doctor", "", "7d")], layout_of)
    text = write(found, "robbie", NOW, Names.of(FOUND))
    assert DOCTOR in text
    assert PLACE in text
    assert DOCTOR not in write(found, "robbie", NOW)


def test_a_question_names_who_asks_as_people_do() -> None:
    made = Browser().log_in()
    (question,) = made.home.questions
    assert isinstance(question, GrantQuestion)
    made.home.names = [PolicyName("/map", "the map", "")]
    heading = made.get("/").text
    assert "the map" in heading


def test_a_service_that_tells_no_names_is_no_failure() -> None:
    made = Browser(as_service(demo()))
    made.now = NOW
    made.home.refusals["policy-names"] = KeyServiceRefused("this service does not do that")
    assert made.log_in().get("/who").status_code == 200
