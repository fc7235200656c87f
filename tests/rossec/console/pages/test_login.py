"""Logging in, by a code or a passkey, and out."""

import pytest

from ca.approvals.passkeys import base64url
from rossec.console.pages.passkeys import FIRST
from rossec.console.rendering import from_base64url
from rossec.errors import KeyServiceFailed
from tests.support.consolepages import ORIGIN, Browser


def b64(data: bytes) -> str:
    return base64url(data)


ASSERTION = {
    "id": b64(b"i" * 16),
    "credential": b64(b"\5" * 32),
    "clientData": b64(b"{}"),
    "authenticatorData": b64(b"data"),
    "signature": b64(b"right"),
}
REGISTRATION = {
    "id": b64(b"i" * 16),
    "name": " my phone ",
    "clientData": b64(b"{}"),
    "attestation": b64(b"object"),
}


def test_the_page_is_for_everyone() -> None:
    answer = Browser().get("/login")
    assert answer.status_code == 200
    assert "Who is there?" in answer.text


def test_without_a_session_every_page_leads_to_it() -> None:
    answer = Browser().get("/phones")
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")


def with_code(browser: Browser, **changes: str) -> dict[str, str]:
    return {**REGISTRATION, "code": browser.home.add_code(), **changes}


def test_a_code_logs_in_to_look() -> None:
    browser = Browser()
    answer = browser.post("/login", data={"code": f" {browser.home.add_code()} "})
    assert (answer.status_code, answer.headers["location"]) == (303, FIRST)
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith("__Host-rossec=")
    for part in ("HttpOnly", "Secure", "SameSite=strict", "Path=/", "Max-Age=28800"):
        assert part in cookie
    found = browser.get("/phones", headers={"Cookie": cookie.partition(";")[0]})
    assert "You are logged in by a code" in found.text


def test_a_code_is_used_once() -> None:
    browser = Browser()
    code = browser.home.add_code()
    assert browser.post("/login", data={"code": code}).status_code == 303
    assert browser.post("/login", data={"code": code}).status_code == 403


def test_a_wrong_code_is_told_and_counted_for_a_minute() -> None:
    browser = Browser()
    for _ in range(5):
        answer = browser.post("/login", data={"code": "wrong"})
        assert answer.status_code == 403
        assert "this code is not valid any more" in answer.text
    assert browser.post("/login", data={"code": browser.home.add_code()}).status_code == 429
    assert browser.post("/login/passkey", json=ASSERTION).status_code == 429
    assert browser.post("/login/phone", json=with_code(browser)).status_code == 429
    browser.now += 60
    assert browser.post("/login/phone", json=with_code(browser)).status_code == 200


def test_a_service_that_does_not_answer_is_nobodys_fault() -> None:
    browser = Browser()
    browser.home.refusals["redeem"] = KeyServiceFailed("it does not run", "rossec ca serve")
    for _ in range(6):
        assert browser.post("/login", data={"code": "any"}).status_code == 503


def test_a_passkey_logs_in() -> None:
    browser = Browser()
    asked = browser.post("/login/challenge", json={}).json()
    assert asked["rpId"] == "localhost"
    assert asked["credentials"] == [ASSERTION["credential"]]
    assert 0 < asked["timeout"] <= 121_000  # whole seconds of two clocks
    assert len(from_base64url(asked["challenge"])) == 32
    assert browser.asked("login-challenge") == [(ORIGIN,)]
    assert browser.post("/login/passkey", json=ASSERTION).json() == {"next": FIRST}
    assert len(browser.context.sessions) == 1


@pytest.mark.parametrize("change", [{"credential": b64(b"x")}, {"signature": "!"}, {"id": 3}])
def test_another_assertion_does_not(change: dict[str, object]) -> None:
    browser = Browser()
    headers = {"Accept": "application/json"}
    answer = browser.post("/login/passkey", json={**ASSERTION, **change}, headers=headers)
    assert answer.status_code in {400, 403}
    assert answer.json()["error"]
    assert len(browser.context.sessions) == 0


def test_a_phone_is_set_up_with_the_code_and_is_logged_in() -> None:
    browser = Browser()
    assert browser.post("/login/new", json={}).json()["rpId"] == "localhost"
    assert browser.asked("new-passkey") == [(ORIGIN, "localhost")]
    answer = browser.post("/login/phone", json=with_code(browser))
    assert answer.json() == {"next": FIRST}
    assert browser.home.phones[-1].name == "my phone"
    assert len(browser.context.sessions) == 1


@pytest.mark.parametrize("change", [{"name": " "}, {"name": "a" * 41}, {"code": "wrong"}])
def test_a_phone_without_a_name_or_code_is_not(change: dict[str, str]) -> None:
    browser = Browser()
    answer = browser.post("/login/phone", json=with_code(browser, **change))
    assert answer.status_code in {400, 403, 422}
    assert len(browser.context.sessions) == 0


def test_logging_out_ends_the_session() -> None:
    browser = Browser().log_in()
    answer = browser.post("/logout")
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")
    assert "Max-Age=0" in answer.headers["set-cookie"]
    assert browser.get("/phones").status_code == 303
