"""The guard: every route of the console with everything that may be wrong with a request."""

import asyncio
import re
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.responses import PlainTextResponse, Response

from rossec.console import app as module
from rossec.console.app import HEADERS, HSTS, IMMUTABLE, ROUTES, RULES, Facts, broken_rule, is_by_person
from rossec.console.rendering import PUBLIC, SESSION, Match, Page, PageAccess, PageTable
from rossec.console.server.control import WebSettings
from rossec.console.sessions import COOKIE, KnownPhones
from rossec.errors import PeerUserRefused
from tests.support.consolepages import ORIGIN, Browser

METHODS = ("DELETE", "PATCH", "POST", "PUT", "TRACE", "OPTIONS", "GET")
CASES = [(page, method) for page in ROUTES for method in page.methods]
ALLOWED = WebSettings("home", (ORIGIN,))


def named(value: object) -> str:
    return value.path if isinstance(value, Page) else str(value)


def address(page: Page) -> str:
    """A path of this page, with something in each of its places."""
    return re.sub(r"\{[^}]*\}", "AAAA", page.path)


@pytest.fixture
def browser() -> Browser:
    return Browser()


def check_headers(response: Any, **others: str) -> None:
    for name, text in {**HEADERS, **others}.items():
        assert response.headers.get_list(name) == [text]


every_route = pytest.mark.parametrize(("page", "method"), CASES, ids=named)


@every_route
def test_without_a_session_only_public_pages_are_there(browser: Browser, page: Page, method: str) -> None:
    answer = browser.request(method, address(page))
    if page.access is PageAccess.PUBLIC:
        assert answer.status_code != 303 or answer.headers["location"] != "/login"
    else:
        assert (answer.status_code, answer.headers["location"]) == (303, "/login")
        script = browser.request(method, address(page), headers={"Accept": "application/json"})
        assert script.status_code == 401
        check_headers(script)
    check_headers(answer, **cache_of(page, answer))


def cache_of(page: Page, answer: Any) -> dict[str, str]:
    is_static = page.path.startswith("/static/") and answer.status_code == 200
    return {"Cache-Control": IMMUTABLE} if is_static else {}


@every_route
@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:7412"},
        {"Origin": "HTTP://LOCALHOST:7411"},
        {"Origin": ""},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "none"},
    ],
    ids=str,
)
def test_what_changes_something_comes_from_an_own_page(
    browser: Browser, page: Page, method: str, headers: dict[str, str]
) -> None:
    if method == "GET":
        return
    answer = browser.log_in().request(method, address(page), headers=headers)
    assert answer.status_code == 403
    check_headers(answer)
    assert [name for name, _ in browser.home.asked if name != "status"] == []


@every_route
def test_an_origin_that_is_missing_is_none_of_ours(browser: Browser, page: Page, method: str) -> None:
    if method == "GET":
        return
    del browser.headers["Origin"]
    answer = browser.log_in().request(method, address(page))
    assert answer.status_code == 403
    assert [name for name, _ in browser.home.asked if name != "status"] == []


@every_route
@pytest.mark.parametrize("host", ["evil.example", "localhost", "127.0.0.1:7411", "localhost:7412"])
def test_another_host_is_misdirected(browser: Browser, page: Page, method: str, host: str) -> None:
    answer = browser.log_in().request(method, address(page), headers={"Host": host})
    assert answer.status_code == 421
    check_headers(answer)
    assert browser.home.asked == []


@every_route
def test_another_method_is_told_which_there_are(browser: Browser, page: Page, method: str) -> None:
    browser.log_in()
    path = address(page)
    found = PageTable(ROUTES).find(path, method)  # `/add/frame` is an `/add/{id}` too
    assert found is not None
    has = found.methods
    for other in METHODS:
        if other in has:
            continue
        answer = browser.request(other, path)
        assert answer.status_code == 405
        assert has <= set(answer.headers["allow"].split(", "))
        check_headers(answer)


@every_route
def test_what_is_too_large_is_not_read(browser: Browser, page: Page, method: str) -> None:
    browser.log_in()
    size = page.max_body + 1

    def pieces() -> Iterator[bytes]:
        yield b"a" * size

    announced = browser.request(method, address(page), content=b"a" * size)
    counted = browser.request(method, address(page), content=pieces())
    for answer in (announced, counted):
        assert answer.status_code == 413
        assert answer.headers["connection"] == "close"
        check_headers(answer)
    assert [name for name, _ in browser.home.asked if name != "status"] == []


def test_every_page_asks_for_a_session_but_those_before_it() -> None:
    public = {page.path for page in ROUTES if page.access is PUBLIC}
    assert public == {
        "/static/{digest}/{name}",
        "/login",
        "/login/challenge",
        "/login/passkey",
        "/login/new",
        "/login/phone",
        "/propose",
    }


def test_headers_of_a_name_with_a_real_certificate() -> None:
    browser = Browser(settings=WebSettings("home", (ORIGIN,), hsts=True))
    check_headers(browser.get("/login"), **{"Strict-Transport-Security": HSTS})
    assert "Strict-Transport-Security" not in Browser().get("/login").headers


def test_a_path_that_is_none() -> None:
    for path in ("/nothing", "/login/", "/static/../app.py", "/login%2f"):
        answer = Browser().log_in().get(path)
        assert answer.status_code == 404
        check_headers(answer)


@pytest.mark.parametrize(
    "cookie", ["", "{0}; {0}", "other={1}", "__Host-rossec=", "__Host-rossec={1}A", "__Host-rossec=\xe4"]
)
def test_a_cookie_that_is_not_the_one(cookie: str) -> None:
    browser = Browser().log_in()
    own = browser.headers["Cookie"]
    given = cookie.format(own, own.partition("=")[2])
    assert browser.get("/phones", headers={"Cookie": given.encode("latin-1")}).status_code == 303
    assert browser.get("/phones", headers={"Cookie": f"a=b; {own}"}).status_code == 200


def test_a_page_that_loads_itself_again_keeps_no_session_alive() -> None:
    browser = Browser().log_in()
    reload = {"Sec-Fetch-Mode": "navigate", "Sec-Fetch-Site": "same-origin"}
    browser.now += 1700
    assert browser.get("/phones", headers=reload).status_code == 200
    browser.now += 200
    assert browser.get("/phones", headers=reload).status_code == 303


def test_a_person_keeps_it_alive() -> None:
    browser = Browser().log_in()
    click = {"Sec-Fetch-Mode": "navigate", "Sec-Fetch-User": "?1"}
    for _ in range(3):
        browser.now += 1700
        assert browser.get("/phones", headers=click).status_code == 200
    assert is_by_person({})
    assert is_by_person({"sec-fetch-mode": "cors", "content-type": "application/json"})
    assert not is_by_person({"sec-fetch-mode": "cors"})


def facts(**changes: Any) -> Facts:
    return Facts("GET", ("localhost:7411",), (), "", 0, has_session=True)._replace(**changes)


async def nothing(*_: object) -> Response:
    return PlainTextResponse("")


PAGE = Page("/", ("GET", "POST"), nothing, SESSION, 10)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({}, None),
        ({"hosts": ()}, "host"),
        ({"hosts": ("localhost:7411", "localhost:7411")}, "host"),
        ({"method": "POST"}, "origin"),
        ({"method": "POST", "origins": (ORIGIN,)}, None),
        ({"method": "POST", "origins": (ORIGIN, ORIGIN)}, "origin"),
        ({"method": "POST", "origins": (ORIGIN,), "site": "same-origin"}, None),
        ({"method": "POST", "origins": (ORIGIN,), "site": "same-site"}, "origin"),
        ({"has_session": False}, "session"),
        ({"length": 11}, "size"),
        ({"length": None}, "size"),
        ({"length": 10}, None),
    ],
)
def test_the_first_rule_that_is_broken(changes: dict[str, Any], rule: str | None) -> None:
    found = broken_rule(facts(**changes), ALLOWED, Match(PAGE, frozenset({"GET"})))
    assert (None if found is None else found.name) == rule


def test_the_order_of_the_rules() -> None:
    """Nothing is said of pages to a wrong host, and nothing of a session to a foreign page."""
    assert [rule.name for rule in RULES] == ["host", "path", "method", "origin", "session", "size"]
    assert broken_rule(facts(), ALLOWED, None) is RULES[1]
    assert broken_rule(facts(), ALLOWED, Match(None, frozenset())) is RULES[2]


async def run(browser: Browser, path: str, receive: Any, send: Any, method: str = "POST") -> None:
    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": method,
        "path": path,
        "query_string": b"",
        "headers": [(b"host", b"localhost:7411"), (b"origin", ORIGIN.encode())],
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 2),
        "scheme": "http",
        "root_path": "",
    }
    await browser.app(scope, receive, send)


async def test_a_body_that_does_not_come_is_not_waited_for(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BODY", 0.01)
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    await run(browser, "/login", asyncio.Event().wait, send)
    assert sent[0]["status"] == 408
    assert (b"connection", b"close") in sent[0]["headers"]


async def test_a_connection_that_ends_is_not_answered(browser: Browser) -> None:
    sent: list[Any] = []

    async def end() -> Any:
        return {"type": "http.disconnect"}

    async def send(message: Any) -> None:
        sent.append(message)

    await run(browser, "/login", end, send)
    assert sent == []


async def test_who_takes_nothing_is_left(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WRITE", 0.01)
    sent: list[Any] = []

    async def empty() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)
        if message["type"] == "http.response.body":
            await asyncio.Event().wait()

    await run(browser, "/login", empty, send, "GET")
    assert [message["type"] for message in sent] == ["http.response.start", "http.response.body"]


def test_a_guard_that_crashes_lets_nobody_pass(
    browser: Browser, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def crash(*_: object) -> None:
        raise RuntimeError("a secret")

    monkeypatch.setattr(module, "check_peer", crash)
    answer = browser.log_in().get("/phones")
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert "a secret" in caplog.text
    check_headers(answer)


def test_another_user_of_the_host_is_refused(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PeerUserRefused("another user", "log in as yourself")

    monkeypatch.setattr(module, "check_peer", refuse)
    answer = browser.log_in().get("/phones")
    assert answer.status_code == 403
    assert browser.home.asked == []
    check_headers(answer)


def test_the_session_cookie_is_for_this_host_alone() -> None:
    assert COOKIE.startswith("__Host-")


def test_a_phone_that_was_removed_at_the_terminal_is_logged_out(browser: Browser) -> None:
    browser.log_in()
    assert browser.get("/phones").status_code == 200
    browser.home.phones[0] = browser.home.phones[0]._replace(ended="it was stolen")
    browser.context.phones = KnownPhones(browser.context.service.phones)  # some seconds later
    for _ in range(2):
        answer = browser.get("/phones")
        assert (answer.status_code, answer.headers["location"]) == (303, "/login")
    assert len(browser.context.sessions) == 0
