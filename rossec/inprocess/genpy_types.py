"""The message types this process reads with, as its genpy classes define them."""

from typing import Any

import genpy.message

from rossec.net.bounds import message_limit, unit_limit
from rossec.participant.definitions import Definition, size_of
from rossec.ros.header import MESSAGE_LIMIT


def definition_of(kind: Any) -> Definition:
    """Name, checksum and definition of the message class `kind`."""
    return Definition(kind._type, kind._md5sum, kind._full_text)  # noqa: SLF001 - genpy's


def installed_definition(name: str) -> Definition | None:
    """The definition of the installed class for the type `name`; None: there is none."""
    try:
        kind = genpy.message.get_message_class(name)
    except Exception:  # noqa: BLE001 - an import may fail in any way; then it is not installed
        return None
    return None if kind is None else definition_of(kind)


def max_message_size(kind: Any) -> int:
    """The most bytes a message of the class `kind` may have."""
    return message_limit(size_of(definition_of(kind)), MESSAGE_LIMIT)


def max_unit_size(kind: Any) -> int:
    """The most bytes a unit with such messages may have."""
    return unit_limit(size_of(definition_of(kind)), MESSAGE_LIMIT)
