"""Cards of relays."""

import json
from typing import Any

import pytest

from rossec.errors import RelayRefused
from rossec.overlay.documents import MAX_CARD, RelayCard

KEY = "rossec/1/office/" + "a" * 32
CARD = RelayCard("office.example", "/relay", KEY)


def test_a_card_is_read_as_it_was_written() -> None:
    assert RelayCard.read(CARD.write().encode()) == CARD
    assert KEY not in repr(CARD)


def test_a_part_of_a_card_is_none() -> None:
    data = CARD.write().encode().rstrip()
    for length in range(len(data)):
        with pytest.raises(RelayRefused, match="not the card of a relay"):
            RelayCard.read(data[:length])
    with pytest.raises(RelayRefused):
        RelayCard.read(data + b"x")
    with pytest.raises(RelayRefused):
        RelayCard.read(data + b" " * MAX_CARD)


@pytest.mark.parametrize(
    "changes",
    [
        {"rossec-relay-card": 2},
        {"more": 1},
        {"domain": "Office"},
        {"domain": 3},
        {"relay": "/robot"},
        {"relay": None},
        {"mailbox": "rossec/**"},
        {"mailbox": []},
    ],
)
def test_a_card_in_another_form_is_refused(changes: dict[str, Any]) -> None:
    found = json.loads(CARD.write()) | changes
    with pytest.raises(RelayRefused, match="card"):
        RelayCard.read(json.dumps(found).encode())


def test_an_entry_that_occurs_twice_is_refused() -> None:
    twice = CARD.write().replace("{", '{"mailbox": "rossec/1/other/' + "b" * 32 + '",', 1)
    with pytest.raises(RelayRefused, match="not the card of a relay"):
        RelayCard.read(twice.encode())
    with pytest.raises(RelayRefused):
        RelayCard.read(CARD.write().replace('card": 1', 'card": true').encode())
