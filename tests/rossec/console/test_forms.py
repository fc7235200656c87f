"""Bodies of requests: forms, JSON, and fields of them."""

from typing import Any

import pytest
from starlette.requests import Request

from ca.approvals.passkeys import base64url
from rossec.console.rendering import Visit, bytes_field, from_base64url, text_field
from rossec.errors import HttpRefused
from tests.support.consolepages import Browser


def visit(body: bytes, kind: str = "application/x-www-form-urlencoded") -> Visit:
    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": body, "more_body": False}

    scope = {
        "type": "http",
        "method": "POST",
        "query_string": b"",
        "headers": [(b"content-type", kind.encode())],
    }
    return Visit(Request(scope, receive), Browser().context)


async def test_a_form_has_its_fields() -> None:
    found = await visit(b"a=1&b=%C3%A4+%26&c=").form()
    assert found == {"a": "1", "b": "ä &", "c": ""}
    assert await visit(b"").form() == {}


@pytest.mark.parametrize("body", [b"a=1&a=2", b"a", b"a=%ff", b"a=\xff", b"&", "&".join("a=1" * 65).encode()])
async def test_another_body_is_no_form(body: bytes) -> None:
    with pytest.raises(HttpRefused):
        await visit(body).form()


async def test_files_are_not_read() -> None:
    with pytest.raises(HttpRefused) as refused:
        await visit(b"a=1", "multipart/form-data; boundary=a").form()
    assert refused.value.status == 415


async def test_a_script_sends_an_object() -> None:
    kind = "application/json; charset=utf-8"
    assert await visit(b'{"a": "1"}', kind).json() == {"a": "1"}


@pytest.mark.parametrize("body", [b"", b"[]", b"1", b'{"a": 1, "a": 2}', b"\xff", b"[" * 5000])
async def test_another_body_is_no_object(body: bytes) -> None:
    with pytest.raises(HttpRefused):
        await visit(body, "application/json").json()


async def test_a_form_is_no_json() -> None:
    with pytest.raises(HttpRefused):
        await visit(b"{}").json()


@pytest.mark.parametrize("value", [1, None, ["a"], "a" * 201])
def test_a_text_is_bounded(value: Any) -> None:
    assert text_field({}, "a") == ""
    assert text_field({"a": "b"}, "a") == "b"
    with pytest.raises(HttpRefused):
        text_field({"a": value}, "a")


def test_bytes_are_base64url_without_padding() -> None:
    for data in (b"a", b"ab", b"abc", bytes(range(256))):
        assert from_base64url(base64url(data)) == data
        assert bytes_field({"a": base64url(data)}, "a") == data


@pytest.mark.parametrize("text", ["", "A", "YQ==", "YR", "+/+/", "Y Q", "é", "YWI\n"])
def test_other_texts_are_no_bytes(text: str) -> None:
    with pytest.raises(HttpRefused):
        from_base64url(text)


@pytest.mark.attack("terminal-output")
async def test_half_a_surrogate_pair_is_no_text() -> None:
    fields = await visit(b'{"name": "a\\ud800", "whole": "\\ud83d\\ude00"}', "application/json").json()
    with pytest.raises(HttpRefused, match="not a text"):
        text_field(fields, "name")
    assert text_field(fields, "whole") == "\U0001f600"
