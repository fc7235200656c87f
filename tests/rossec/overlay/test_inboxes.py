"""Keys of inboxes."""

import pytest

from rossec.overlay.link_frames import inbox, is_account, is_inbox

BOX = bytes(range(16))
KEY = "rossec/1/home/000102030405060708090a0b0c0d0e0f"


def test_an_inbox_has_an_account_and_a_random_box() -> None:
    assert inbox("home", BOX) == KEY
    assert is_inbox(KEY)


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
def test_nothing_else_is_an_inbox(key: str) -> None:
    assert not is_inbox(key)


@pytest.mark.parametrize("account", ["", "Home", "a" * 33, "a/b", "*", "a\n", "ä"])
def test_an_account_of_an_inbox_has_a_syntax(account: str) -> None:
    assert not is_account(account)
    with pytest.raises(ValueError, match="not the key of an inbox"):
        inbox(account, BOX)


def test_an_inbox_with_a_box_of_another_length_is_a_bug() -> None:
    with pytest.raises(ValueError, match="not the key"):
        inbox("home", b"short")
