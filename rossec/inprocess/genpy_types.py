"""Message types as the classes of this process have them: by these its program reads."""

from typing import Any

import genpy.message

from rossec.channel.records import ChannelLimits
from rossec.net.bounds import message_limit, unit_limit
from rossec.participant.definitions import Definition, size_of


def described(kind: Any) -> Definition:
    """What the message class `kind` says of itself."""
    return Definition(kind._type, kind._md5sum, kind._full_text)  # noqa: SLF001 - genpy's


def installed(name: str) -> Definition | None:
    """What the class says by which a program would read the type `name`; None: there is none."""
    try:
        kind = genpy.message.get_message_class(name)
    except Exception:  # noqa: BLE001 - an import may fail in any way; then nothing is known
        return None
    return None if kind is None else described(kind)


def longest(kind: Any) -> int:
    """How long a message of the class `kind` may be, in bytes."""
    return message_limit(size_of(described(kind)), ChannelLimits.unit)


def room(kind: Any) -> int:
    """How long a unit with such messages may be."""
    return unit_limit(size_of(described(kind)), ChannelLimits.unit)
