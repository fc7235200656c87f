"""The headers of every response."""

from rossec.console.app import HEADERS, HSTS, IMMUTABLE, security_headers


def named(headers: list[tuple[bytes, bytes]]) -> dict[str, str]:
    assert len(headers) == len({name for name, _ in headers})
    return {name.decode(): text.decode() for name, text in headers}


def test_every_response_has_them() -> None:
    assert named(security_headers()) == {name.lower(): text for name, text in HEADERS.items()}


def test_a_static_file_is_kept_and_a_real_name_insists_on_https() -> None:
    found = named(security_headers(immutable=True, hsts=True))
    assert found["cache-control"] == IMMUTABLE
    assert found["strict-transport-security"] == HSTS


def test_no_script_but_own_files_and_no_html_made_by_one() -> None:
    rules = dict(rule.split(" ", 1) for rule in HEADERS["Content-Security-Policy"].split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == rules["style-src"] == rules["connect-src"] == "'self'"
    assert rules["trusted-types"] == "'none'"
    assert rules["frame-ancestors"] == rules["base-uri"] == "'none'"
    assert "unsafe" not in HEADERS["Content-Security-Policy"]
    # With no-referrer a browser would send `Origin: null` with the console's own forms.
    assert HEADERS["Referrer-Policy"] == "same-origin"
