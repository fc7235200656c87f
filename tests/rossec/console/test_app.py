"""Refusals as pages, and as JSON for scripts."""

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.testclient import TestClient

from ca.errors import HintedError
from rossec.console.app import create_app, show_error, status_of
from rossec.console.rendering import PUBLIC, Page
from rossec.errors import AuthorityLocked, HttpRefused, KeyServiceFailed
from tests.support.consolepages import ORIGIN, Browser


@pytest.mark.parametrize(
    ("error", "status"),
    [(HttpRefused("a", status=404), 404), (KeyServiceFailed("a"), 503), (AuthorityLocked("a"), 422)],
)
def test_a_refusal_has_a_status(error: HintedError, status: int) -> None:
    assert status_of(error) == status


def asked(accept: str) -> Request:
    headers = [(b"accept", accept.encode())]
    return Request(
        {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": headers, "state": {}}
    )


def test_a_refusal_is_a_page_or_json() -> None:
    context, error = Browser().context, AuthorityLocked("it is <locked>\n", "unlock it")
    page = show_error(asked("text/html"), context, error)
    assert b"It is &lt;locked&gt;\\u000a" in bytes(page.body)
    told = show_error(asked("application/json"), context, error)
    assert bytes(told.body) == b'{"error":"it is <locked>\\\\u000a","hint":"unlock it"}'


def test_a_page_that_is_not_there_offers_the_first_one_once() -> None:
    text = Browser().log_in().get("/nothing").text
    assert text.lower().count("first page") == 1
    assert "Is the address right?" in text


def test_names_are_asked_for_pages_and_not_for_scripts() -> None:
    browser = Browser().log_in()
    browser.get("/phones")
    assert len(browser.asked("policy-names")) == 1
    browser.get("/phones", headers={"Accept": "application/json"})
    browser.get("/login")
    assert len(browser.asked("policy-names")) == 1


@pytest.mark.parametrize("accept", ["text/html", "application/json"])
def test_a_crash_is_logged_and_not_told(accept: str, caplog: pytest.LogCaptureFixture) -> None:
    async def crash(*_: object) -> Response:
        raise RuntimeError("a secret")

    app = create_app(Browser().context, (Page("/", ("GET",), crash, PUBLIC),))
    answer = TestClient(app, ORIGIN).get("/", headers={"Accept": accept})
    assert answer.status_code == 500
    assert "something went wrong here" in answer.text.lower()
    assert "secret" not in answer.text
    assert "a secret" in caplog.text
