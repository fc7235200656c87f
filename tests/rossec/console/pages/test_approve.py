"""Preparing and approving: the two requests of every kind."""

from ca.approvals.passkeys import base64url
from rossec.errors import AuthorityLocked
from tests.support.consolepages import Browser

JSON = {"Accept": "application/json"}
ASSERTION = {
    "credential": base64url(b"\5" * 32),
    "clientData": base64url(b"{}"),
    "authenticatorData": base64url(b"data"),
    "signature": base64url(b"right"),
}
FORM = {"proposal": base64url(b"\6" * 16)}


def test_a_form_becomes_a_statement_and_its_assertion_an_approval() -> None:
    browser = Browser().log_in()
    asked = browser.post("/prepare/passkey", data=FORM, headers=JSON).json()
    assert asked["credentials"] == [ASSERTION["credential"]]
    assert asked["rpId"] == "localhost"
    assert 0 < asked["timeout"] <= 301_000
    assert [each[:2] for each in browser.asked("prepare")] == [("passkey", [b"\6" * 16])]
    answer = browser.post(f"/approve/{asked['id']}", json=ASSERTION, headers=JSON)
    assert answer.json() == {"next": "/phones"}
    (given,) = browser.asked("approve")
    assert given[1:] == (b"\5" * 32, b"{}", b"data", b"right")


def test_one_touch_is_one_approval() -> None:
    browser = Browser().log_in()
    asked = browser.post("/prepare/passkey", data=FORM, headers=JSON).json()
    assert browser.post(f"/approve/{asked['id']}", json=ASSERTION).status_code == 200
    again = browser.post(f"/approve/{asked['id']}", json=ASSERTION, headers=JSON)
    assert (again.status_code, again.json()["error"]) == (404, "this was not asked here")
    assert len(browser.asked("approve")) == 1


def test_another_session_cannot_finish_it() -> None:
    browser = Browser().log_in()
    asked = browser.post("/prepare/passkey", data=FORM, headers=JSON).json()
    other = browser.context.sessions.begin(b"o" * 32, "Anna's phone", browser.now)
    headers = {**JSON, "Cookie": f"__Host-rossec={other}"}
    assert browser.post(f"/approve/{asked['id']}", json=ASSERTION, headers=headers).status_code == 404
    assert browser.asked("approve") == []


def test_without_a_phone_nothing_is_asked() -> None:
    browser = Browser().log_in("")
    browser.home.phones.clear()
    answer = browser.post("/prepare/passkey", data=FORM, headers=JSON)
    assert answer.status_code == 409
    assert answer.json()["hint"] == "get a code at the terminal: rossec console phone"


def test_what_the_service_refuses_is_told() -> None:
    browser = Browser().log_in()
    browser.home.refusals["prepare"] = AuthorityLocked("the key is locked", "rossec ca unlock")
    answer = browser.post("/prepare/passkey", data=FORM, headers=JSON)
    assert answer.status_code == 422
    assert answer.json() == {"error": "the key is locked", "hint": "rossec ca unlock"}


def test_a_form_with_other_fields_is_not_sent_on() -> None:
    browser = Browser().log_in()
    for kind, form in (("passkey", {**FORM, "more": "1"}), ("nothing", FORM), ("passkey", {})):
        assert browser.post(f"/prepare/{kind}", data=form, headers=JSON).status_code == 422
    assert browser.asked("prepare") == []


def test_an_assertion_that_is_not_whole_is_not_sent_on() -> None:
    browser = Browser().log_in()
    asked = browser.post("/prepare/passkey", data=FORM, headers=JSON).json()
    for name in ASSERTION:
        fields = {key: text for key, text in ASSERTION.items() if key != name}
        assert browser.post(f"/approve/{asked['id']}", json=fields).status_code == 400
    assert browser.asked("approve") == []
