"""The type a publisher claims, to show its messages by: one that is known here, or its definition.

Nothing is decided by it. A type that is known here counts as it is known here.
"""

from rossec.errors import MessageError
from rossec.participant.definitions import Definition
from rossec.participant.message_types import MessageType, message_type, register_types


def readable(claimed: Definition) -> MessageType:
    """The type to read messages of `claimed` by.

    Raises:
        MessageError: its name has another definition here, or the definition is none.
    """
    try:
        known = message_type(claimed.name)
    except MessageError:
        register_types({claimed.name: claimed.definition})
        known = message_type(claimed.name)
    if known.md5sum != claimed.md5sum:
        raise MessageError(
            f"the publisher's {claimed.name} is another one than here",
            "its messages cannot be read by the definition that is installed here",
        )
    return known
