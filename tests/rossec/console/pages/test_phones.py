"""The page of phones: list, link, proposal, removal."""

from ca.approvals.passkeys import base64url
from rossec.authority.console.messages import Proposal
from rossec.console.pages.passkeys import REMOVED
from rossec.console.server.control import WebSettings
from tests.support.consolepages import ORIGIN, Browser

PHONE = base64url(b"\5" * 32)


def test_phones_are_listed_with_what_waits_to_be_approved() -> None:
    browser = Browser().log_in()
    text = browser.get("/phones").text
    assert "Anna&#39;s phone" in text
    assert 'action="/prepare/passkey" data-approve' in text
    assert f'name="proposal" value="{base64url(bytes([6]) * 16)}"' in text
    assert "123 456" in text


def test_names_are_data() -> None:
    browser = Browser().log_in()
    browser.home.proposals = [Proposal(b"\6" * 16, "<b>\u202ephone</b>", "123456", browser.now)]
    text = browser.get("/phones").text
    assert "<b>\u202e" not in text
    assert "&lt;b&gt;\\u202ephone&lt;/b&gt;" in text


def test_a_link_for_another_phone_is_shown_as_a_code() -> None:
    browser = Browser().log_in()
    answer = browser.post("/phones/link")
    (code,) = browser.home.codes
    assert f"{ORIGIN}/propose#{code}" in answer.text
    assert "<svg" in answer.text


def test_removing_a_phone_ends_its_sessions() -> None:
    browser = Browser().log_in()
    answer = browser.post(f"/phones/{PHONE}/remove")
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")
    assert browser.asked("remove-phone") == [(b"\5" * 32, REMOVED)]
    assert len(browser.context.sessions) == 0


def test_removing_another_phone_leads_back() -> None:
    browser = Browser().log_in("")
    answer = browser.post(f"/phones/{PHONE}/remove")
    assert (answer.status_code, answer.headers["location"]) == (303, "/phones")
    assert "Removed" in browser.get("/phones").text


def test_a_phone_whose_digits_differ_is_not_added() -> None:
    browser = Browser().log_in("")
    (proposal,) = browser.home.proposals
    path = f"/phones/{base64url(proposal.id)}/differ"
    assert f'action="{path}"' in browser.get("/phones").text
    answer = browser.post(path)
    assert (answer.status_code, answer.headers["location"]) == (303, "/phones")
    assert browser.asked("end-proposal") == [(proposal.id,)]
    assert "wants to approve too" not in browser.get("/phones").text


def test_a_screen_that_only_shows_offers_no_buttons() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), read_only=True)).log_in()
    assert "/remove" not in browser.get("/phones").text


def test_a_new_phone_proposes_its_passkey_and_shows_digits() -> None:
    browser = Browser()
    assert "Set up this phone" in browser.get("/propose").text
    fields = {
        "id": base64url(b"i" * 16),
        "code": browser.home.add_code(),
        "name": "Ben's phone",
        "clientData": base64url(b"{}"),
        "attestation": base64url(b"object"),
    }
    answer = browser.post("/propose", json=fields)
    assert answer.json() == {"digits": "004 217"}
    assert browser.post("/propose", json=fields).status_code == 403
    assert len(browser.context.sessions) == 0
