"""What a request's body says: a form's fields, or the JSON object a script sends.

Read strictly: the guard has bounded the body; here one type, UTF-8, each field once. There are no
files in forms, so no multipart.
"""

import base64
import binascii
import json
import re
from typing import Any, Final
from urllib.parse import parse_qsl

from starlette.requests import Request

from rossec.errors import HttpRefused

MAX_FIELDS: Final = 64
_FORM: Final = "application/x-www-form-urlencoded"
_JSON: Final = "application/json"
_HALVES: Final = re.compile("[\ud800-\udfff]")
_HINT: Final = "go back, load the page again, and try once more"


async def read_form(request: Request) -> dict[str, str]:
    """The fields of a form.

    Raises:
        HttpRefused: another type, malformed, not UTF-8, or a field that comes twice.
    """
    body = await request.body()
    if not body:
        return {}  # a form of a button alone
    _require_type(request, _FORM)
    try:
        pairs = parse_qsl(
            body.decode("ascii"), keep_blank_values=True, strict_parsing=True,
            encoding="utf-8", errors="strict", max_num_fields=MAX_FIELDS,
        )  # fmt: skip
    except ValueError as error:  # UnicodeDecodeError is one
        raise HttpRefused("a form that is malformed", _HINT) from error
    return _once(pairs)


async def read_json(request: Request) -> dict[str, Any]:
    """The JSON object of a script.

    Raises:
        HttpRefused: another type, malformed, or not an object with each name once.
    """
    _require_type(request, _JSON)
    try:
        value = json.loads((await request.body()).decode(), object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise HttpRefused("JSON that is malformed", _HINT) from error
    if not isinstance(value, dict):
        raise HttpRefused("JSON that is no object", _HINT)
    return value


def text_field(fields: dict[str, Any], name: str, limit: int = 200) -> str:
    """A field that is text of at most `limit` characters; absent: empty.

    JSON can escape half of a surrogate pair, which is no text (RFC 8259 section 8.2).

    Raises:
        HttpRefused: of another type, or longer.
    """
    value = fields.get(name, "")
    if not isinstance(value, str) or len(value) > limit or _HALVES.search(value):
        raise HttpRefused(f"{name}: not a text of at most {limit} characters", _HINT)
    return value


def bytes_field(fields: dict[str, Any], name: str) -> bytes:
    """A field that is bytes, as base64url without padding, as WebAuthn's JSON has them.

    Raises:
        HttpRefused: absent, of another type, or malformed.
    """
    return from_base64url(text_field(fields, name, limit=16 * 1024))


def from_base64url(text: str) -> bytes:
    """The bytes of a base64url text without padding.

    Raises:
        HttpRefused: empty or malformed.
    """
    try:
        data = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError) as error:
        raise HttpRefused("bytes that are not base64url", _HINT) from error
    if not data or to_base64url(data) != text:
        raise HttpRefused("bytes that are not base64url", _HINT)
    return data


def to_base64url(data: bytes) -> str:
    """Bytes as base64url without padding."""
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def _require_type(request: Request, wanted: str) -> None:
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != wanted:
        raise HttpRefused(f"a body that is not {wanted}", _HINT, status=415)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise HttpRefused("a field that comes twice", _HINT)
    return fields
