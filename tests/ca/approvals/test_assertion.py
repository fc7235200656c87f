from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.approvals.passkeys import Assertion, AuthenticatorData, verify
from ca.errors import ApprovalRefused
from tests.support import refusal_texts
from tests.support.approving import registered
from tests.support.passkeys import CREATE, UP, UV, Passkey

CHALLENGE, OTHER = b"c" * 32, b"o" * 32
DEVICE = Passkey(counts=False)
PASSKEY = registered(DEVICE)
SIGNED = Assertion(*DEVICE.sign(CHALLENGE))


def sign(challenge: bytes = CHALLENGE, **changes: Any) -> Assertion:
    return Assertion(*DEVICE.sign(challenge, **changes))


def test_an_assertion_of_this_challenge_is_accepted() -> None:
    assert verify(SIGNED, PASSKEY, CHALLENGE, 0) == 0
    assert verify(sign(cross_origin=None), PASSKEY, CHALLENGE, 0) == 0


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"kind": CREATE}, refusal_texts.OTHER_CHALLENGE),
        ({"challenge": OTHER}, refusal_texts.OTHER_CHALLENGE),
        ({"origin": "http://127.0.0.1:7411"}, refusal_texts.OTHER_ORIGIN),
        ({"cross_origin": True}, refusal_texts.OTHER_ORIGIN),
        ({"rp_id": "evil.example"}, refusal_texts.OTHER_ORIGIN),
        ({"flags": UP}, refusal_texts.NOT_VERIFIED),
        ({"flags": UV}, refusal_texts.NOT_VERIFIED),
    ],
)
def test_each_check_refuses_by_its_own_error(changes: dict[str, Any], error: str) -> None:
    with pytest.raises(ApprovalRefused, match=error):
        verify(sign(**changes), PASSKEY, CHALLENGE, 0)


def test_the_checks_are_in_the_order_of_the_standard() -> None:
    """Each of these has one fault more than the one before, and is refused for the newest."""
    forged = {"flags": 0}
    faults: list[tuple[str, dict[str, Any]]] = [
        (refusal_texts.NOT_VERIFIED, forged),
        (refusal_texts.OTHER_ORIGIN, {**forged, "rp_id": "evil.example"}),
        (refusal_texts.OTHER_ORIGIN, {**forged, "origin": "https://evil.example"}),
        (refusal_texts.OTHER_CHALLENGE, {**forged, "origin": "https://evil.example", "challenge": OTHER}),
    ]
    for error, changes in faults:
        with pytest.raises(ApprovalRefused, match=error):
            verify(sign(**changes), PASSKEY, CHALLENGE, 5)


def test_another_passkey_is_refused() -> None:
    with pytest.raises(ApprovalRefused, match="of another passkey"):
        verify(SIGNED._replace(credential=b"x"), PASSKEY, CHALLENGE, 0)


@pytest.mark.parametrize(
    ("counter", "before", "accepted"),
    [(0, 0, True), (1, 0, True), (9, 8, True), (8, 8, False), (7, 8, False), (0, 8, False)],
)
def test_the_counter_increases_or_is_always_zero(counter: int, before: int, accepted: bool) -> None:
    device = Passkey()
    device.count = counter - 1
    assertion = Assertion(*device.sign(CHALLENGE))
    assert AuthenticatorData.read(assertion.authenticator_data).counter == counter
    if accepted:
        assert verify(assertion, registered(device), CHALLENGE, before) == counter
    else:
        with pytest.raises(ApprovalRefused, match=f"is {counter} and was {before}"):
            verify(assertion, registered(device), CHALLENGE, before)


def test_a_signature_by_another_key_is_refused() -> None:
    stranger = Passkey(counts=False)
    stranger.id = DEVICE.id
    with pytest.raises(ApprovalRefused, match='"Ann\'s phone" did not sign this'):
        verify(Assertion(*stranger.sign(CHALLENGE)), PASSKEY, CHALLENGE, 0)


@pytest.mark.parametrize("size", [0, 1, 80])
def test_a_signature_that_is_none_is_refused(size: int) -> None:
    with pytest.raises(ApprovalRefused, match=refusal_texts.ASSERTION_FORGED):
        verify(SIGNED._replace(signature=bytes(size)), PASSKEY, CHALLENGE, 0)


def test_a_large_signature_is_refused() -> None:
    with pytest.raises(ApprovalRefused, match="a signature of 81 bytes"):
        verify(SIGNED._replace(signature=bytes(81)), PASSKEY, CHALLENGE, 0)


@given(st.sampled_from(("client_data", "authenticator_data")), st.data())
def test_any_other_byte_is_refused(field: str, data: st.DataObject) -> None:
    changed = bytearray(getattr(SIGNED, field))
    changed[data.draw(st.integers(0, len(changed) - 1))] ^= data.draw(st.integers(1, 255))
    with pytest.raises(ApprovalRefused):
        verify(SIGNED._replace(**{field: bytes(changed)}), PASSKEY, CHALLENGE, 0)
