"""Templates: everything is escaped, nothing undefined passes."""

import pytest
from jinja2 import UndefinedError
from starlette.requests import Request

from rossec.console import rendering
from rossec.console.app import ROUTES
from rossec.console.context import ConsoleContext
from rossec.console.rendering import NAVIGATION, Visit
from tests.support.consolepages import Browser

HOSTILE = '<script>alert("1")</script>\u202e\x00'


def request() -> Request:
    state = {"session": None}
    return Request(
        {"type": "http", "method": "GET", "path": "/x", "query_string": b"", "headers": [], "state": state}
    )


@pytest.fixture
def context() -> ConsoleContext:
    rendering.environment.cache_clear()
    return Browser().context


def test_a_text_is_data(context: ConsoleContext) -> None:
    values = {"message": HOSTILE, "hint": HOSTILE}
    body = bytes(Visit(request(), context).show("error.html", 422, **values).body).decode()
    assert "<script>alert" not in body
    assert "\u202e" not in body
    assert "\x00" not in body
    assert "&lt;script&gt;" in body
    assert "\\u202e" in body


def test_what_is_missing_is_a_mistake(context: ConsoleContext) -> None:
    with pytest.raises(UndefinedError):
        Visit(request(), context).show("error.html")


def test_the_navigation_is_for_who_is_logged_in() -> None:
    assert "<nav" not in Browser().get("/login").text
    text = Browser().log_in().get("/phones").text
    assert '<a href="/phones" aria-current="page">' in text
    for place in NAVIGATION:
        assert f'href="{place.path}"' in text


def test_every_place_of_the_navigation_is_a_page() -> None:
    assert {place.path for place in NAVIGATION} <= {page.path for page in ROUTES}


def test_times_are_told_as_days(context: ConsoleContext) -> None:
    browser = Browser().log_in()
    browser.home.phones[0] = browser.home.phones[0]._replace(at=1_800_000_000)
    assert "January 2027" in browser.get("/phones").text
