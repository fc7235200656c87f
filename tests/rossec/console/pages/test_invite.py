"""Join codes: the form, the code once, and the end of one."""

from ca.approvals.passkeys import base64url
from rossec.authority.console.messages import ApprovalOutcome
from rossec.console.pages.adding import ENDED
from rossec.console.server.control import WebSettings
from tests.support.consolehome import HOSTILE
from tests.support.consolepages import ORIGIN, Browser

MADE = b"\x09" * 16
PATH = f"/invited/{base64url(MADE)}"
TEXT = "ROSSEC-JOIN:ABCDEFGH"


def made(state: str = "done", data: bytes = TEXT.encode()) -> Browser:
    browser = Browser().log_in()
    browser.home.outcomes[MADE] = ApprovalOutcome(MADE, state, "", data)
    return browser


def own(browser: Browser) -> bytes:
    cookie = browser.headers["Cookie"].partition("=")[2]
    session = browser.context.sessions.find(cookie, browser.now)
    assert session is not None
    return session.id


def test_making_one_is_approved_and_those_that_are_open_are_listed() -> None:
    text = Browser().log_in().get("/invite").text
    assert 'action="/prepare/invitation" data-approve' in text
    for field in ("pattern", "uses", "lasts", "anonymous"):
        assert f'name="{field}"' in text
    assert "/lamp/*" in text
    assert "1 of 5 used" in text
    assert "joined:" in text


def test_the_code_is_shown_once_to_the_session_that_made_it() -> None:
    browser = made()
    assert TEXT not in browser.get(PATH).text
    browser.context.made_codes.add(MADE, own(browser), True, "")
    text = browser.get(PATH).text
    assert TEXT in text
    assert "<svg" in text
    again = browser.get(PATH).text
    assert TEXT not in again
    assert "shown already" in again


def test_a_code_that_waits_for_the_key_is_shown_when_it_is_made() -> None:
    browser = made("waiting", b"")
    browser.context.made_codes.add(MADE, own(browser), True, "")
    assert "The key is locked" in browser.get(PATH).text
    browser.home.outcomes[MADE] = ApprovalOutcome(MADE, "done", "", TEXT.encode())
    assert TEXT in browser.get(PATH).text


def test_a_code_that_was_not_made_says_why() -> None:
    browser = made("failed", b"")
    browser.home.outcomes[MADE] = ApprovalOutcome(MADE, "failed", "too late", b"")
    assert "too late" in browser.get(PATH).text


def test_ending_one_needs_only_the_session() -> None:
    browser = Browser().log_in("")
    number = browser.home.invitations[0].id
    answer = browser.post(f"/invite/{base64url(number)}/end")
    assert (answer.status_code, answer.headers["location"]) == (303, "/invite")
    assert browser.asked("end-invitation") == [(number, ENDED)]
    assert "ended: ended at the console" in browser.get("/invite").text


def test_texts_are_data() -> None:
    browser = Browser().log_in()
    (found,) = browser.home.invitations
    browser.home.invitations = [
        found._replace(pattern=HOSTILE, names=(HOSTILE,)),
        found._replace(state=f"ended: {HOSTILE}"),
        found._replace(expires=1),
    ]
    text = browser.get("/invite").text
    assert "<script>alert" not in text
    assert "\u202e" not in text
    assert "expired" in text


def test_a_screen_that_only_shows_offers_nothing() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), read_only=True)).log_in()
    assert "<form" not in browser.get("/invite").text
