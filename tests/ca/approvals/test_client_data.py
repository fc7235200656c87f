import json
from typing import Any

import pytest

from ca.approvals.passkeys import MAX_CLIENT_DATA, Ceremony, base64url, check_client_data
from ca.errors import ApprovalRefused

CHALLENGE = bytes(range(32))
ORIGIN = "http://localhost:7411"
RIGHT = {"type": "webauthn.get", "challenge": base64url(CHALLENGE), "origin": ORIGIN}


def check(data: bytes) -> None:
    check_client_data(data, Ceremony.GET, CHALLENGE, ORIGIN)


@pytest.mark.parametrize(
    "more", [{}, {"crossOrigin": False}, {"other_keys_can_be_added_here": "do not compare"}]
)
def test_client_data_of_this_challenge_and_page(more: dict[str, Any]) -> None:
    check(json.dumps({**RIGHT, **more}).encode())


def test_base64url_has_no_padding() -> None:
    assert base64url(b"\xfb\xff\xfe\x00") == "-__-AA"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"type": "webauthn.create"}, "not used for webauthn.get"),
        ({"type": None}, "not used for webauthn.get"),
        ({"challenge": base64url(bytes(32))}, "signed something else"),
        ({"challenge": base64url(CHALLENGE) + "="}, "signed something else"),
        ({"challenge": 1}, "signed something else"),
        ({"origin": "http://localhost"}, "'http://localhost' instead of http://loc"),
        ({"origin": ORIGIN + "/"}, "instead of"),
        ({"origin": "https://localhost:7411"}, "instead of"),
        ({"origin": [ORIGIN]}, "instead of"),
        ({"origin": "\x1b[2J" + "x" * 999}, r"'\\x1b\[2Jx{76}' instead"),
        ({"crossOrigin": True}, "inside another page"),
        ({"crossOrigin": None}, "inside another page"),
        ({"crossOrigin": 0}, "inside another page"),
        ({"topOrigin": ORIGIN}, "inside another page"),
    ],
)
def test_another_challenge_or_page_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ApprovalRefused, match=message):
        check(json.dumps({**RIGHT, **fields}).encode())


@pytest.mark.parametrize("field", sorted(RIGHT))
def test_a_missing_field_is_refused(field: str) -> None:
    fields = {name: value for name, value in RIGHT.items() if name != field}
    with pytest.raises(ApprovalRefused, match=r"the passkey (was not|was used at|signed something else)"):
        check(json.dumps(fields).encode())


TEXT = json.dumps(RIGHT)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"null",
        b"[]",
        TEXT.encode() + b"x",
        TEXT.encode()[:-1],
        b"\xef\xbb\xbf" + TEXT.encode(),
        TEXT.replace("localhost", "\udcff").encode(errors="surrogateescape"),
        TEXT.encode("utf-16"),
        TEXT.replace("{", '{"origin": "https://evil", ').encode(),
        TEXT.replace("{", '{"a": {"b": 1, "b": 2}, ').encode(),
        TEXT.replace("{", '{"a": NaN, ').encode(),
        b"[" * MAX_CLIENT_DATA,
        TEXT.encode() + b" " * MAX_CLIENT_DATA,
    ],
)
def test_what_is_not_strict_json_is_refused(data: bytes) -> None:
    with pytest.raises(ApprovalRefused, match="the browser sent") as error:
        check(data)
    assert error.value.hint == "try again, or with another browser"
