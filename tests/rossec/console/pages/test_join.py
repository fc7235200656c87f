"""The page of a request for an identity that waits in the record."""

import pytest

from ca.approvals.passkeys import base64url
from rossec.console.enrollments import REJECTED
from rossec.console.server.control import WebSettings
from tests.support.consolehome import HOSTILE
from tests.support.consolepages import ORIGIN, Browser

PATH = f"/join/{base64url(bytes([1]) * 32)}"


def test_the_card_is_that_of_a_node_that_is_added() -> None:
    text = Browser().log_in().get(PATH).text
    assert "A node asks to join" in text
    assert "/lamp" in text
    assert "0202 0202" in text
    assert f'name="request" value="{base64url(bytes([1]) * 32)}"' in text
    assert text.index(">Approve<") < text.index(">Reject<")


def test_a_key_that_changed_is_an_alarm() -> None:
    browser = Browser().log_in()
    browser.home.requests = [browser.home.requests[0]._replace(is_other_key=True)]
    text = browser.get(PATH).text
    assert "has CHANGED" in text
    assert text.index(">Reject<") < text.index("replace the key")
    assert 'name="name"' in text


def test_what_is_approved_waits_for_the_key() -> None:
    browser = Browser().log_in()
    browser.home.requests = [browser.home.requests[0]._replace(state="approved")]
    text = browser.get(PATH).text
    assert "rossec ca unlock" in text
    assert "<form" not in text


def test_rejecting_needs_only_the_session() -> None:
    browser = Browser().log_in("")
    answer = browser.post(f"{PATH}/reject")
    assert (answer.status_code, answer.headers["location"]) == (303, PATH)
    assert browser.asked("deny-request") == [(bytes([1]) * 32, REJECTED)]
    assert "This is answered" in browser.get(PATH).text


@pytest.mark.parametrize("anonymous", [False, True])
def test_texts_of_strangers_are_data(anonymous: bool) -> None:
    browser = Browser().log_in()
    (request,) = browser.home.requests
    browser.home.requests = [request._replace(name=HOSTILE, source=HOSTILE, anonymous=anonymous)]
    text = browser.get(PATH).text
    assert "<script>alert" not in text
    assert "\u202e" not in text
    assert ("anonymous nodes too" in text) is anonymous


def test_a_screen_that_only_shows_offers_nothing() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), read_only=True)).log_in()
    assert "<form" not in browser.get(PATH).text
