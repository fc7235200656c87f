"""Keys of mailboxes."""

import pytest

from rossec.overlay.link_frames import is_mailbox, is_seat, mailbox

BOX = bytes(range(16))
KEY = "rossec/1/home/000102030405060708090a0b0c0d0e0f"


def test_a_mailbox_has_a_seat_and_a_random_box() -> None:
    assert mailbox("home", BOX) == KEY
    assert is_mailbox(KEY)


@pytest.mark.parametrize(
    "key",
    [
        "",
        KEY + "0",
        KEY[:-1],
        KEY.upper(),
        f"{KEY}\n",
        KEY.replace("home", "ho me"),
        f"x{KEY}",
        KEY.replace("home", "**"),
        KEY.replace("home", "a" * 33),
    ],
)
def test_nothing_else_is_a_mailbox(key: str) -> None:
    assert not is_mailbox(key)


@pytest.mark.parametrize("seat", ["", "Home", "a" * 33, "a/b", "*", "a\n", "ä"])
def test_a_seat_of_a_mailbox_has_a_syntax(seat: str) -> None:
    assert not is_seat(seat)
    with pytest.raises(ValueError, match="not the key of a mailbox"):
        mailbox(seat, BOX)


def test_a_mailbox_with_a_box_of_another_length_is_a_bug() -> None:
    with pytest.raises(ValueError, match="not the key"):
        mailbox("home", b"short")
