"""The page of a question."""

import pytest

from ca.approvals.passkeys import base64url
from ca.errors import HintedError
from grants.document import scope_of
from grants.model import Permission, Right
from rossec.authority.console.messages import FactView, QuestionAnswer
from rossec.console.pages.decisions import DENIED
from rossec.console.server.control import WebSettings
from rossec.errors import KeyServiceRefused
from tests.support.consolehome import HOSTILE
from tests.support.consolepages import ORIGIN, Browser

PATH = f"/ask/{base64url(bytes([3]) * 16)}"


def test_the_heading_is_the_sentence() -> None:
    text = Browser().log_in().get(PATH).text
    heading = text[text.index("<h1") : text.index("</h1>")]
    assert "/map" in heading
    assert "see where" in heading
    assert "/robot" in heading
    assert "autofocus" in heading


def test_the_reason_is_the_nodes_own_words() -> None:
    browser = Browser().log_in()
    text = browser.get(PATH).text
    assert "in its own words" in text
    assert "<q><bdi>to draw &lt;b&gt;where&lt;/b&gt; it was</bdi></q>" in text
    (question,) = browser.home.questions
    browser.home.questions = [question._replace(why="")]
    assert "It does not say why" in browser.get(PATH).text


def test_each_way_to_answer_is_shown_in_words_and_pictures() -> None:
    text = Browser().log_in().get(PATH).text
    assert text.count("All of it, as it asks") == 2
    assert "Coarser" in text
    assert text.count("<svg") >= 3
    assert "(all of it)" in text
    assert "position to 0.5 m" in text
    assert 'name="coarse" value="coarse" checked' in text, "the narrowest"
    assert text.index('name="coarse" value="room"') < text.index('name="coarse" value=""')
    assert text.count(" checked") == 1
    assert "It would only look" in text


def test_a_command_looks_different_from_reading() -> None:
    browser = Browser().log_in()
    (question,) = browser.home.questions
    drive = question.rights[0]._replace(
        right=int(Right.PUBLISH),
        pattern="/cmd_vel",
        type="geometry_msgs/Twist",
        permissions=scope_of([Permission("/cmd_vel", Right.PUBLISH)]),
    )
    other = question._replace(id=b"\4" * 16, rights=(drive,), coarse=())
    browser.home.rights = (drive,)
    browser.home.questions = [question, other]
    text = browser.get(f"/ask/{base64url(other.id)}").text
    assert 'class="acts"' in text
    assert "It would act, not only look" in text
    assert "drive: send commands to" in text
    assert "there is no coarser form of it" in text
    assert "It asked for 1 more thing at the same time" in text
    assert 'class="acts"' not in browser.get(PATH).text
    today = browser.get("/").text
    assert today.count("It would act, not only look") == 1


def test_the_durations_are_four_buttons_and_none_promises_too_much() -> None:
    text = Browser().log_in().get(PATH).text
    for value in ("today", "week", "month", "open"):
        assert f'<button name="duration" value="{value}"' in text
    assert 'value="month" disabled' in text
    assert "the policy allows 7 days" in text


def test_denying_needs_only_the_session() -> None:
    browser = Browser().log_in("")
    answer = browser.post(f"{PATH}/deny")
    assert (answer.status_code, answer.headers["location"]) == (303, PATH)
    assert browser.asked("deny-question") == [(bytes([3]) * 16, DENIED)]
    text = browser.get(PATH).text
    assert ">Denied</h1>" in text
    assert "may not see" in text
    assert "denied at the console" in text


@pytest.mark.parametrize(
    ("answer", "heading"),
    [
        ("granted", "Approved"),
        ("no answer", "Denied: nobody answered in time"),
        ("too many", "This is answered"),
    ],
)
def test_how_it_was_answered_is_said(answer: str, heading: str) -> None:
    browser = Browser().log_in()
    (question,) = browser.home.questions
    browser.home.questions = []
    given = QuestionAnswer("/map", 2, "/robot/pose", answer, HOSTILE, browser.now)
    browser.home.answers[question.id] = [given]
    text = browser.get(PATH).text
    assert f">{heading}</h1>" in text
    assert "<script>alert" not in text
    browser.home.refusals["question-answers"] = KeyServiceRefused("this service does not do that")
    assert ">This is answered</h1>" in browser.get(PATH).text


def test_a_filter_that_does_not_fit_is_not_offered() -> None:
    browser = Browser().log_in()
    browser.home.refusals["consider"] = KeyServiceRefused("only subscriptions can be coarse")
    text = browser.get(PATH).text
    assert 'name="coarse" value="" checked' in text
    assert 'value="room"' not in text


def test_without_a_master_the_topic_is_named() -> None:
    browser = Browser().log_in()
    refusal: HintedError = KeyServiceRefused("the master is out of reach")
    browser.home.refusals["graph"] = refusal
    heading = browser.get(PATH).text.partition("<h1")[2].partition("</h1>")[0]
    assert "/robot/pose" in heading


def test_texts_of_a_node_are_data() -> None:
    browser = Browser().log_in()
    (question,) = browser.home.questions
    right = question.rights[0]._replace(why=HOSTILE, type="no/" + HOSTILE)
    browser.home.questions = [question._replace(why=HOSTILE, node="/" + HOSTILE, rights=(right,))]
    browser.home.graph = [FactView("publisher", "/robot/pose", HOSTILE)]
    text = browser.get(PATH).text
    assert "<script>alert" not in text
    assert "\u202e" not in text


def test_a_screen_that_only_shows_offers_no_buttons() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), read_only=True)).log_in()
    assert "<form" not in browser.get(PATH).text
