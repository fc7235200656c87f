"""Logging in, by a code or a passkey, and out."""

import pytest

from rossec.console.forms import to_base64url
from tests.support.consolepages import CODE, FIRST, Browser


def b64(data: bytes) -> str:
    return to_base64url(data)


ASSERTION = {
    "id": b64(b"i" * 16),
    "credential": b64(b"passkey"),
    "clientData": b64(b"{}"),
    "authenticatorData": b64(b"data"),
    "signature": b64(b"right"),
}
REGISTRATION = {
    "id": b64(b"i" * 16),
    "code": CODE,
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


def test_a_code_logs_in_to_look() -> None:
    browser = Browser()
    answer = browser.post("/login", data={"code": f" {CODE} "})
    assert (answer.status_code, answer.headers["location"]) == (303, FIRST)
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith("__Host-rossec=")
    for part in ("HttpOnly", "Secure", "SameSite=strict", "Path=/", "Max-Age=28800"):
        assert part in cookie
    value = cookie.partition(";")[0]
    found = browser.get("/phones", headers={"Cookie": value})
    assert "You are logged in by a code" in found.text


def test_a_wrong_code_is_told_and_counted() -> None:
    browser = Browser()
    for _ in range(5):
        answer = browser.post("/login", data={"code": "wrong"})
        assert answer.status_code == 403
        assert "the code is not known" in answer.text
    assert browser.post("/login", data={"code": CODE}).status_code == 429
    assert browser.post("/login/passkey", json=ASSERTION).status_code == 429
    assert browser.post("/login/phone", json=REGISTRATION).status_code == 429


def test_a_passkey_logs_in() -> None:
    browser = Browser()
    asked = browser.post("/login/challenge", json={}).json()
    assert asked == {
        "id": ASSERTION["id"],
        "challenge": b64(b"c" * 32),
        "credentials": [b64(b"passkey")],
        "rpId": "localhost",
        "timeout": 300_000,
    }
    answer = browser.post("/login/passkey", json=ASSERTION)
    assert answer.json() == {"next": FIRST}
    assert len(browser.context.sessions) == 1


@pytest.mark.parametrize("change", [{"signature": b64(b"wrong")}, {"signature": "!"}, {"id": 3}])
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
    answer = browser.post("/login/phone", json=REGISTRATION)
    assert answer.json() == {"next": FIRST}
    assert browser.service.calls[-1][2] == "my phone"
    assert len(browser.context.sessions) == 1


@pytest.mark.parametrize("change", [{"name": " "}, {"name": "a" * 41}, {"code": "wrong"}])
def test_a_phone_without_a_name_or_code_is_not(change: dict[str, str]) -> None:
    browser = Browser()
    answer = browser.post("/login/phone", json={**REGISTRATION, **change})
    assert answer.status_code in {400, 403, 422}
    assert len(browser.context.sessions) == 0


def test_logging_out_ends_the_session() -> None:
    browser = Browser().log_in()
    answer = browser.post("/logout")
    assert (answer.status_code, answer.headers["location"]) == (303, "/login")
    assert "Max-Age=0" in answer.headers["set-cookie"]
    assert browser.get("/phones").status_code == 303
