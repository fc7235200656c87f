"""Requests: one form, signed by the node, of these days, for this authority."""

from dataclasses import replace

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, encode
from ca.errors import NameRefused
from ca.keys.signer import KeySigner
from grants.document import GRANT
from grants.errors import GrantForged, GrantMalformed, PatternRefused
from grants.model import Right
from grants.request import (
    FRESH,
    REQUEST,
    SKEW,
    GrantRequest,
    RequestedRight,
    open_request,
    peek_request,
    sign_request,
)
from tests.grants.authority import NOW

NODE = KeySigner(ec.generate_private_key(ec.SECP256R1()))
ASKED = GrantRequest(
    "home",
    "/toaster",
    NOW,
    bytes(16),
    (RequestedRight(Right.SUBSCRIBE, "/robot/pose"),),
    "to toast",
)
CLAIMS: dict[int | str, Value] = {
    2: "/toaster", 3: "home", 6: NOW, 7: bytes(16), 9: encode([["/robot/pose", 2]]),
    -65538: "to toast",
}  # fmt: skip


def opened(data: bytes, *, domain: str = "home", now: int = NOW) -> GrantRequest:
    return open_request(data, NODE.public_key, domain=domain, now=now)


def test_what_was_asked_comes_back() -> None:
    data = sign_request(NODE, ASKED)
    assert opened(data) == ASKED
    assert opened(data).id == ASKED.id
    assert len(ASKED.id) == 16
    assert replace(ASKED, why="").id != ASKED.id
    assert REQUEST.sign(NODE, CLAIMS)[:-64] == data[:-64]


@pytest.mark.parametrize("shift", [-SKEW - 1, FRESH + 1])
def test_only_of_these_days(shift: int) -> None:
    with pytest.raises(GrantForged, match="not of these days"):
        opened(sign_request(NODE, ASKED), now=NOW + shift)


def test_only_for_this_authority() -> None:
    with pytest.raises(GrantForged, match="to the authority of 'home', not 'ward'"):
        opened(sign_request(NODE, ASKED), domain="ward")


def test_only_with_the_key_of_the_node() -> None:
    stranger = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    with pytest.raises(GrantForged, match="not a request of /toaster"):
        opened(sign_request(stranger, ASKED))


@pytest.mark.parametrize(
    "change",
    [
        {2: "toaster"}, {2: 5}, {3: b"home"}, {6: True}, {6: -1}, {7: bytes(15)}, {9: b""},
        {9: encode([])}, {9: encode([["/a", 3]])}, {9: encode([["/a", 0]])},
        {9: encode([["/a", 256]])}, {9: encode([["a", 1]])}, {9: encode(["/a"])},
        {9: encode([["/a", 1, 1]])}, {9: encode([["/a", 1]] * 65)}, {9: encode(5)},
        {-65538: "x" * 501}, {4: 5},
    ],
)  # fmt: skip
def test_anything_else_is_none(change: dict[int | str, Value]) -> None:
    with pytest.raises(GrantMalformed):
        opened(REQUEST.sign(NODE, {**CLAIMS, **change}))


def test_what_is_no_request_at_all() -> None:
    for data in (b"", b"\xd2\x80", GRANT.sign(NODE, CLAIMS), REQUEST.sign(NODE, [])):
        with pytest.raises(GrantMalformed):
            peek_request(data)


def test_a_request_that_cannot_be_made() -> None:
    with pytest.raises(NameRefused):
        replace(ASKED, node="toaster")
    with pytest.raises(PatternRefused):
        replace(ASKED, rights=(RequestedRight(Right.CALL, "x"),))
