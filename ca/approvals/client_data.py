"""The client data of WebAuthn: what a browser says about the page that used a passkey. Pure.

Strict JSON of at most 4 KiB in which no key occurs twice. Unknown keys are allowed, as browsers add
some on purpose (Web Authentication section 5.8.1). Checked in the order of section 7.2: type,
challenge, origin, and that the page was not embedded in another.
"""

import base64
import json
from enum import StrEnum
from typing import Any, Final, NoReturn

from ca.errors import AssertionMalformed, OtherChallenge, OtherOrigin

MAX_CLIENT_DATA: Final = 4096


class Ceremony(StrEnum):
    """What a passkey was used for, as the browser calls it."""

    CREATE = "webauthn.create"
    GET = "webauthn.get"


def check_client_data(data: bytes, ceremony: Ceremony, challenge: bytes, origin: str) -> None:
    """Return if `data` is of this ceremony, challenge and origin.

    Raises:
        AssertionMalformed: not client data.
        OtherChallenge: another challenge, or a signature for another purpose.
        OtherOrigin: made at another page, or in a frame.
    """
    value = _parse(data)
    if value.get("type") != ceremony:
        raise OtherChallenge(f"the passkey was not used for {ceremony}", "try again on the page")
    if value.get("challenge") != base64url(challenge):
        raise OtherChallenge(
            "the passkey signed something else",
            "look at the page again: what it shows may have changed",
        )
    found = value.get("origin")
    if found != origin:
        raise OtherOrigin(
            f"the passkey was used at {str(found)[:80]!a} instead of {origin}",
            "open the console by its own address, and register the phone there",
        )
    if value.get("crossOrigin", False) is not False or "topOrigin" in value:
        raise OtherOrigin(
            "the passkey was used inside another page", "open the console in a tab of its own"
        )


def base64url(data: bytes) -> str:
    """Base64url without padding."""
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def _parse(data: bytes) -> dict[str, Any]:
    if len(data) > MAX_CLIENT_DATA:
        raise _malformed(f"{len(data)} bytes of client data")
    try:
        value = json.loads(
            data.decode(), object_pairs_hook=_unique, parse_constant=_refuse_constant
        )
    except (ValueError, RecursionError) as error:
        raise _malformed("client data that is not JSON") from error
    if not isinstance(value, dict):
        raise _malformed("client data that is no object")
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("a key occurs twice")
    return value


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _malformed(what: str) -> AssertionMalformed:
    return AssertionMalformed(f"the browser sent {what}", "try again, or with another browser")
