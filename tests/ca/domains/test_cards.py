"""Cards: signed by the root in them, and nothing else is believed of them."""

import dataclasses
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.domains.trust import MAX_CARD, SKEW, open_card, sign_card
from ca.errors import CardRefused, CertificateRefused, PatternRefused
from tests.support.pki import DAY, NOW, new_signer
from tests.vectors.make_domains import CARDS, FILE, HOSPITAL

V = json.loads(FILE.read_text())
CARD = CARDS["with masters"]
DATA = bytes.fromhex(V["cards"]["with masters"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a field is missing", "missing or unknown fields"),
        ("a root of another key", "does not verify"),
        ("no root", "not a well-formed certificate"),
        ("no names", "no names"),
        ("a number for a name", "is not one"),
        ("an address of another scheme", "is not a master's address"),
        ("never valid", "never valid"),
        ("for too long", "more than 30 days"),
        ("expired", "expired 1 s ago"),
        ("from the future", "from the future"),
    ],
)
def test_the_reason_for_a_refusal(name: str, message: str) -> None:
    with pytest.raises(CardRefused, match=message) as caught:
        open_card(bytes.fromhex(V["refused_cards"][name]["data"]), NOW)
    assert caught.value.hint


def test_every_byte_of_a_card_counts() -> None:
    for at in range(0, len(DATA), 5):
        for changed in (DATA[:at] + bytes([DATA[at] ^ 1]) + DATA[at + 1 :], DATA[:at]):
            with pytest.raises(CardRefused):
                open_card(changed, NOW)
    for more in (DATA + b"\0", DATA + bytes(MAX_CARD)):
        with pytest.raises(CardRefused):
            open_card(more, NOW)


@given(st.binary(max_size=200))
def test_other_bytes_are_no_card(data: bytes) -> None:
    with pytest.raises(CardRefused):
        open_card(data, NOW)


def test_a_card_holds_from_shortly_before_its_time_until_its_end() -> None:
    assert open_card(DATA, NOW - SKEW) == open_card(DATA, CARD.expires - 1) == CARD
    for at in (NOW - SKEW - 1, CARD.expires):
        with pytest.raises(CardRefused):
            open_card(DATA, at)


def test_a_card_is_about_its_signer() -> None:
    assert CARD.anchor.domain == "hospital.example"
    assert CARD.anchor is CARD.anchor
    with pytest.raises(CardRefused, match="not about this authority"):
        sign_card(new_signer(), CARD)
    assert open_card(sign_card(HOSPITAL, CARD), NOW) == CARD


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"names": ()}, CardRefused),
        ({"names": ("/a*",)}, PatternRefused),
        ({"masters": ("http://a b",)}, CardRefused),
        ({"masters": ("https://a",)}, CardRefused),
        ({"masters": ("http://h:11311\n",)}, CardRefused),
        ({"masters": ("http://h:11311",) * 9}, CardRefused),
        ({"issued": -1}, CardRefused),
        ({"issued": True}, CardRefused),
        ({"expires": NOW + 31 * DAY}, CardRefused),
    ],
)
def test_a_card_that_is_none(change: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        dataclasses.replace(CARD, **change)
    with pytest.raises(CertificateRefused):
        _ = dataclasses.replace(CARD, root=b"").anchor
