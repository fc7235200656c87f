"""What restrictions mean for the messages of one connection, as its publisher's header says. Pure.

Each side applies those of the other: a publisher the subscriber's, before a message is sent; a
subscriber the publisher's, before it is believed. Nobody trusts who is restricted to hold to it.
"""

from collections.abc import Callable, Mapping

from grants import layout
from grants.decision import Decision
from grants.guard import Guard, needed_keys
from rossec.errors import TopicRefused
from rossec.node.fields import text

FilterKey = Callable[[str], bytes]


def guard_of(
    fields: Mapping[str, bytes], decision: Decision, filter_key: FilterKey
) -> Guard | None:
    """The guard for the messages that a publisher describes in `fields`; None: nothing to apply.

    The end of the right is not its matter then: the watch over the connection cuts it.

    Raises:
        TopicRefused: the definition does not prove the checksum, by which both sides know the type.
        GrantError: the restrictions were written for another type.
    """
    if not decision.restrictions:
        return None
    name, md5sum = text(fields, "type"), text(fields, "md5sum")
    return guard_for(name, md5sum, _definition(fields), decision, filter_key)


def guard_for(
    name: str, md5sum: str, definition: str, decision: Decision, filter_key: FilterKey
) -> Guard:
    """The guard for messages of a type, whatever `decision` says; raises as `guard_of`."""
    shape = layout.parse(name, definition)
    if shape.md5 != md5sum:
        raise TopicRefused(
            f"the definition of {name} does not have the md5sum of the connection",
            "the grant is restricted, and what is sent cannot be told",
        )
    keys = {key: filter_key(key) for key in needed_keys(decision.restrictions)}
    return Guard(shape, decision, keys)


def _definition(fields: Mapping[str, bytes]) -> str:
    try:
        return fields.get("message_definition", b"").decode()
    except UnicodeDecodeError:
        raise TopicRefused("a message definition that is not UTF-8") from None
