import json

import pytest

from ca.enrollment import qr
from ca.enrollment.qr import card_code, check_code
from ca.errors import CardRefused, CodeRefused
from tests.vectors.make_domains import FILE

V = json.loads(FILE.read_text())
CARD, OTHER = (bytes.fromhex(V["cards"][name]) for name in ("with masters", "without masters"))


def test_a_code_fits_one_card() -> None:
    text = card_code(CARD)
    assert text.startswith(qr.PREFIX)
    check_code(text, CARD)
    check_code(f"  {text}\n", CARD)
    with pytest.raises(CardRefused, match="does not fit the code"):
        check_code(text, OTHER)
    with pytest.raises(CardRefused, match="does not fit the code"):
        check_code(text, CARD + b"\0")


def test_a_code_has_a_place_on_a_small_terminal() -> None:
    lines = qr.terminal(card_code(CARD)).splitlines()
    assert len(lines) <= 20
    assert len(qr.encode_base45(CARD)) > 800  # the card itself would have 45 lines


@pytest.mark.parametrize(
    "text",
    [
        "",
        "ROSSEC:",
        "ROSSEC:A",
        "ROSSEC:##",
        card_code(CARD)[:-1],
        card_code(CARD) + "00",
        card_code(CARD)[7:],
        "ROSSEC:" + "0" * 90,
        qr.label_code(b"a request"),
    ],
)
def test_other_texts_are_no_codes_of_cards(text: str) -> None:
    with pytest.raises(CodeRefused) as caught:
        check_code(text, CARD)
    assert caught.value.hint


def test_an_enrollment_takes_no_code_of_a_card() -> None:
    with pytest.raises(CodeRefused):
        qr.parse(card_code(CARD))
