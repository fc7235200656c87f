"""Keys of mailboxes: where a relay is reached through routers. Pure.

`rossec/1/<seat>/<box>`: the seat is the name that the routers' operator gave a customer, the box is
random. No name, label, domain or topic is in a key (docs/spec/overlay.md): routers see it.
"""

import re
from typing import Final

from rossec.errors import ConfigurationError, RelayRefused

PREFIX: Final = "rossec/1"
BOX_OCTETS: Final = 16
OPEN_SEAT: Final = "open"  # the seat of routers without access control
_SEAT: Final = re.compile(r"[a-z0-9]{1,32}", re.ASCII)
_KEY: Final = re.compile(rf"{PREFIX}/([a-z0-9]{{1,32}})/([0-9a-f]{{32}})", re.ASCII)


def check_seat(text: str) -> str:
    """Return `text` if it is the name of a seat.

    Raises:
        ConfigurationError: anything else.
    """
    if _SEAT.fullmatch(text) is None:
        raise ConfigurationError(
            f"{text[:64]!a} is not the name of a seat", "1 to 32 lower case letters and digits"
        )
    return text


def mailbox_key(seat: str, box: bytes) -> str:
    """The key of a mailbox below `seat`; `box` has 16 random octets.

    Raises:
        ConfigurationError: not a seat.
    """
    if len(box) != BOX_OCTETS:
        raise ValueError(f"a box has {BOX_OCTETS} octets")
    return f"{PREFIX}/{check_seat(seat)}/{box.hex()}"


def check_mailbox(key: str) -> str:
    """Return `key` if it is that of a mailbox.

    Raises:
        RelayRefused: anything else.
    """
    if _KEY.fullmatch(key) is None:
        raise RelayRefused("this is not the key of a mailbox", "take the whole card of the relay")
    return key


def seat_of(key: str) -> str:
    """The seat in the key of a mailbox; raises as `check_mailbox`."""
    return check_mailbox(key).split("/")[2]
