"""Which pages can have which passkeys."""

import pytest

from ca.errors import ApprovalRefused
from rossec.authority.console.messages import check_page
from tests.support import refusal_texts


@pytest.mark.parametrize(
    ("origin", "rp_id"),
    [
        ("http://localhost:7411", "localhost"),
        ("http://localhost", "localhost"),
        ("https://rossec.local:7411", "rossec.local"),
        ("https://ca.example.org", "example.org"),
        ("https://ca.example.org", "ca.example.org"),
        ("https://robot", "robot"),
    ],
)
def test_check_page_allows_its_own_name(origin: str, rp_id: str) -> None:
    check_page(origin, rp_id)


@pytest.mark.parametrize(
    ("origin", "rp_id"),
    [
        ("http://rossec.local", "rossec.local"),
        ("https://10.0.0.5", "10.0.0.5"),
        ("https://ca.example.org", "example.com"),
        ("https://badexample.org", "example.org"),
        ("https://example.org", "ca.example.org"),
        ("https://ca.example.org/", "example.org"),
        ("https://ca.example.org/x", "example.org"),
        ("https://u@example.org", "example.org"),
        ("https://EXAMPLE.org", "example.org"),
        ("https://example.org", "EXAMPLE.org"),
        ("https://[::1]", "::1"),
        ("https://[::1", "x"),
        ("null", "localhost"),
        ("", ""),
        ("https://example.org:99999", "example.org"),
        ("https://localhost.", "localhost"),
        ("http://127.0.0.1:7411", "127.0.0.1"),
        ("https://x.y", ""),
        ("ftp://localhost", "localhost"),
        (f"https://{'a.' * 200}org", "org"),
        ("https://example.org?q", "example.org"),
        ("http://localhost:7411\n", "localhost"),
    ],
)
def test_check_page_refuses_everything_else(origin: str, rp_id: str) -> None:
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_REFUSED) as caught:
        check_page(origin, rp_id)
    assert caught.value.hint
