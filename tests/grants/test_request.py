"""Requests: one encoding, signed by the node, recent, for this authority."""

from dataclasses import replace

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, encode
from ca.errors import NameRefused, PatternRefused
from ca.keys.signing import KeySigner
from grants.document import GRANT
from grants.errors import GrantForged, GrantMalformed
from grants.model import Right
from grants.request import (
    MAX_AGE,
    MAX_CLOCK_SKEW,
    REQUEST,
    GrantRequest,
    RequestedRight,
    open_request,
    peek_request,
    sign_request,
)
from tests.grants.authority import NOW

NODE = KeySigner(ec.generate_private_key(ec.SECP256R1()))
REQUESTED = GrantRequest(
    "home", "/toaster", NOW, bytes(16), (RequestedRight(Right.SUBSCRIBE, "/robot/pose"),), "to toast"
)
CLAIMS: dict[int | str, Value] = {
    2: "/toaster",
    3: "home",
    6: NOW,
    7: bytes(16),
    9: encode([["/robot/pose", 2]]),
    -65538: "to toast",
}


def opened(data: bytes, *, domain: str = "home", now: int = NOW) -> GrantRequest:
    return open_request(data, NODE.public_key, domain=domain, now=now)


def test_a_request_round_trips() -> None:
    data = sign_request(NODE, REQUESTED)
    assert opened(data) == REQUESTED
    assert opened(data).id == REQUESTED.id
    assert len(REQUESTED.id) == 16
    assert replace(REQUESTED, why="").id != REQUESTED.id
    assert REQUEST.sign(NODE, CLAIMS)[:-64] == data[:-64]


@pytest.mark.parametrize("shift", [-MAX_CLOCK_SKEW - 1, MAX_AGE + 1])
def test_an_old_or_future_request_is_refused(shift: int) -> None:
    with pytest.raises(GrantForged, match="too old, or dated in the future"):
        opened(sign_request(NODE, REQUESTED), now=NOW + shift)


def test_a_request_to_another_authority_is_refused() -> None:
    with pytest.raises(GrantForged, match="to the authority of 'home', not 'ward'"):
        opened(sign_request(NODE, REQUESTED), domain="ward")


def test_a_request_signed_by_another_key_is_refused() -> None:
    other = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    with pytest.raises(GrantForged, match="not a request of /toaster"):
        opened(sign_request(other, REQUESTED))


@pytest.mark.parametrize(
    "change",
    [
        {2: "toaster"},
        {2: 5},
        {3: b"home"},
        {6: True},
        {6: -1},
        {7: bytes(15)},
        {9: b""},
        {9: encode([])},
        {9: encode([["/a", 3]])},
        {9: encode([["/a", 0]])},
        {9: encode([["/a", 256]])},
        {9: encode([["a", 1]])},
        {9: encode(["/a"])},
        {9: encode([["/a", 1, 1]])},
        {9: encode([["/a", 1]] * 65)},
        {9: encode(5)},
        {-65538: "x" * 501},
        {4: 5},
    ],
)
def test_malformed_claims_are_refused(change: dict[int | str, Value]) -> None:
    with pytest.raises(GrantMalformed):
        opened(REQUEST.sign(NODE, {**CLAIMS, **change}))


def test_other_statements_are_refused() -> None:
    for data in (b"", b"\xd2\x80", GRANT.sign(NODE, CLAIMS), REQUEST.sign(NODE, [])):
        with pytest.raises(GrantMalformed):
            peek_request(data)


def test_invalid_names_cannot_be_requested() -> None:
    with pytest.raises(NameRefused):
        replace(REQUESTED, node="toaster")
    with pytest.raises(PatternRefused):
        replace(REQUESTED, rights=(RequestedRight(Right.CALL, "x"),))


def test_names_of_anonymous_nodes_are_asked_for_by_their_identity_alone() -> None:
    right = RequestedRight(Right.PROVIDE, "/toaster~/get_loggers")
    asked = replace(REQUESTED, rights=(right,))
    assert opened(sign_request(NODE, asked)).rights == (right,)
    for pattern in ("/other~/get_loggers", "/toaster_1~/get_loggers"):
        with pytest.raises(GrantMalformed, match="another's anonymous nodes"):
            replace(REQUESTED, rights=(RequestedRight(Right.PROVIDE, pattern),))
    for pattern in ("{node}/pose", "~/pose", "/toaster~x"):
        with pytest.raises(PatternRefused):
            replace(REQUESTED, rights=(RequestedRight(Right.PROVIDE, pattern),))
