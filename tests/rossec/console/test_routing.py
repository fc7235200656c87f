"""Pages are found by path and method."""

import pkgutil

from starlette.responses import Response

from rossec.console import pages
from rossec.console.app import ROUTES
from rossec.console.rendering import MAX_BODY, SESSION, Page, PageTable, for_looking


async def nothing(*_: object) -> Response:
    return Response()


GET = Page("/a/{id}", ("GET",), nothing)
POST = Page("/a/{id}", ("POST",), nothing)
FIXED = Page("/a/b", ("GET",), nothing)


def test_a_page_is_found_by_its_path_and_method() -> None:
    table = PageTable((FIXED, GET, POST))
    for path, method, page in (
        ("/a/c", "GET", GET),
        ("/a/c", "HEAD", GET),
        ("/a/c", "POST", POST),
        ("/a/b", "GET", FIXED),
        ("/a/c", "PUT", None),
    ):
        found = table.find(path, method)
        assert found is not None
        assert found.page is page
        assert found.methods == {"GET", "HEAD", "POST"}
    for path in ("/", "/a", "/a/", "/a/b/c", "/a/b/"):
        assert table.find(path, "GET") is None


def test_a_page_needs_a_session_unless_it_says_otherwise() -> None:
    assert (GET.access, GET.max_body) == (SESSION, MAX_BODY)


def test_every_module_of_pages_is_in_the_table() -> None:
    modules = {page.handler.__module__ for page in ROUTES}
    for found in pkgutil.iter_modules(pages.__path__):
        assert f"{pages.__name__}.{found.name}" in modules


def test_a_console_that_only_shows_has_no_form_that_acts() -> None:
    look = Page("/login", ("POST",), nothing, looks=True)
    assert for_looking((GET, POST, FIXED, look)) == (FIXED, look)
    kept = {page.path for page in for_looking(ROUTES) if "POST" in page.methods}
    assert kept == {"/login", "/login/challenge", "/login/passkey", "/logout"}
    assert "/who" in {page.path for page in for_looking(ROUTES)}
