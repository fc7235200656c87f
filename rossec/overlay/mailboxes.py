"""Keys of mailboxes, `rossec/1/<seat>/<box>`. Pure.

A seat is the router operator's name for a customer, a box 16 random bytes: no name, label, domain
or topic is in a key. Whoever puts to a key that came from outside checks it here first: a key with
a wildcard would be put to many mailboxes.
"""

import re
from typing import Final

BOX: Final = 16  # bytes
_KEY: Final = re.compile(r"rossec/1/[a-z0-9]{1,32}/[0-9a-f]{32}")
_SEAT: Final = re.compile(r"[a-z0-9]{1,32}")


def is_seat(name: str) -> bool:
    """Whether `name` may be that of a seat."""
    return _SEAT.fullmatch(name) is not None


def is_mailbox(key: str) -> bool:
    """Whether `key` is the key of exactly one mailbox."""
    return _KEY.fullmatch(key) is not None


def mailbox(seat: str, box: bytes) -> str:
    """The key of the mailbox `box` (16 random bytes) of a seat.

    Raises:
        ValueError: not a seat's name, or a box of another length.
    """
    key = f"rossec/1/{seat}/{box.hex()}"
    if not is_mailbox(key):
        raise ValueError("not the key of a mailbox")
    return key
