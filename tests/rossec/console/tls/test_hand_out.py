import re
from base64 import b64encode
from hashlib import sha256
from html.parser import HTMLParser

import httpx
import pytest
from starlette.types import ASGIApp

from rossec.console.tls import certificates
from rossec.console.tls.hand_out import FILE, PAGE, create_hand_out, documents
from rossec.errors import ConfigurationError
from tests.support.console_tls import new_authority

ORIGIN = "https://rossec.local:7411"
CERTIFICATE = new_authority().data


def client_of(app: ASGIApp) -> httpx.AsyncClient:
    transport = httpx.ASGITransport(app)
    return httpx.AsyncClient(transport=transport, base_url="http://rossec.local:7410")


@pytest.fixture
def client() -> httpx.AsyncClient:
    return client_of(create_hand_out(CERTIFICATE, ORIGIN, lambda: False))


async def test_the_certificate_is_handed_out_as_browsers_install_it(client: httpx.AsyncClient) -> None:
    answer = await client.get(FILE)
    assert (answer.status_code, answer.content) == (200, CERTIFICATE)
    assert answer.headers["content-type"] == "application/x-x509-ca-cert"


async def test_the_page_tells_to_compare_and_shows_no_fingerprint(client: httpx.AsyncClient) -> None:
    text = (await client.get(PAGE)).text
    assert "Compare before you trust it" in text
    assert "terminal" in text
    assert text.count(ORIGIN) == 3
    assert certificates.in_hex(CERTIFICATE)[:11] not in text
    assert certificates.in_words(CERTIFICATE) not in text


@pytest.mark.parametrize("device", ["iPhone", "Android", "Firefox", "Chrome"])
async def test_the_page_explains_each_device(client: httpx.AsyncClient, device: str) -> None:
    assert f"<summary>{device}" in (await client.get(PAGE)).text


def test_the_page_is_well_formed_and_has_no_script() -> None:
    found: list[str] = []

    class Tags(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            found.append(tag)
            assert not [name for name, _ in attrs if name.startswith("on") or name == "style"]

    Tags().feed(documents(CERTIFICATE, ORIGIN)[PAGE].body.decode())
    assert {"html", "main", "h1", "details"} <= set(found)
    assert not {"script", "form", "input", "img", "iframe", "link"} & set(found)


async def test_its_policy_allows_its_own_style_and_nothing_else(client: httpx.AsyncClient) -> None:
    answer = await client.get(PAGE)
    style = re.search(r"<style>(.*?)</style>", answer.text, re.DOTALL)
    assert style is not None
    digest = b64encode(sha256(style[1].encode()).digest()).decode()
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; ")
    assert f"style-src 'sha256-{digest}'" in policy
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("path", ["/login", "/static/style.css", "/rossec-console.crt/", "/%2e%2e/tls.key"])
async def test_there_is_nothing_else(client: httpx.AsyncClient, path: str) -> None:
    assert (await client.get(path)).status_code == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "HEAD", "OPTIONS", "DELETE"])
@pytest.mark.parametrize("path", [PAGE, FILE])
async def test_it_takes_nothing(client: httpx.AsyncClient, method: str, path: str) -> None:
    assert (await client.request(method, path)).status_code == 405


async def test_it_is_over() -> None:
    over = client_of(create_hand_out(CERTIFICATE, ORIGIN, lambda: True))
    assert {(await over.get(path)).status_code for path in (PAGE, FILE, "/other")} == {410}


async def test_it_speaks_no_web_socket() -> None:
    async def unused(*_: object) -> dict[str, object]:
        raise AssertionError

    app = create_hand_out(CERTIFICATE, ORIGIN, lambda: False)
    with pytest.raises(ConfigurationError, match="only HTTP"):
        await app({"type": "websocket", "path": "/"}, unused, unused)  # type: ignore[arg-type]
