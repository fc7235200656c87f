"""Keys of mailboxes."""

import pytest

from rossec.errors import ConfigurationError, RelayRefused
from rossec.overlay.mailboxes import check_mailbox, check_seat, mailbox_key, seat_of

BOX = bytes(range(16))
KEY = "rossec/1/home/000102030405060708090a0b0c0d0e0f"


def test_a_mailbox_has_a_seat_and_a_random_box() -> None:
    assert mailbox_key("home", BOX) == KEY
    assert check_mailbox(KEY) == KEY
    assert seat_of(KEY) == "home"


@pytest.mark.parametrize(
    "key",
    ["", KEY + "0", KEY[:-1], KEY.upper(), f"{KEY}\n", KEY.replace("home", "ho me"), f"x{KEY}",
     KEY.replace("home", "**"), KEY.replace("home", "a" * 33)],
)  # fmt: skip
def test_nothing_else_is_one(key: str) -> None:
    with pytest.raises(RelayRefused, match="not the key of a mailbox"):
        check_mailbox(key)


@pytest.mark.parametrize("seat", ["", "Home", "a" * 33, "a/b", "*", "a\n", "ä"])
def test_a_seat_has_a_syntax(seat: str) -> None:
    with pytest.raises(ConfigurationError, match="not the name of a seat"):
        check_seat(seat)
    with pytest.raises(ConfigurationError):
        mailbox_key(seat, BOX)


def test_a_box_of_another_length_is_a_bug() -> None:
    with pytest.raises(ValueError, match="16 octets"):
        mailbox_key("home", b"short")
