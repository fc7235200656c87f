"""What restrictions mean for the messages of one connection. Pure.

Each side applies those of the other: a publisher the subscriber's, before a message is sent; a
subscriber the publisher's, before it is believed. Nobody trusts who is restricted to hold to it,
nor what it says of its messages (`definitions`).
"""

from collections.abc import Callable

from grants.decision import Decision
from grants.guard import Guard, needed_keys
from grants.memory import MemoryScope
from rossec.participant.definitions import Definition, needs_definition

FilterKey = Callable[[str], bytes]


def guard_for(
    kind: Definition, decision: Decision, filter_key: FilterKey, recall: MemoryScope
) -> Guard | None:
    """The guard for messages of `kind`; None: nothing to apply.

    `recall` finds what earlier connections of the same key have used up.

    The end of the right is not its matter then: the watch over the connection cuts it.

    Raises:
        TopicRefused, DefinitionRefused: `kind` does not say what its messages are.
        GrantError: the restrictions were written for another type.
    """
    if not decision.restrictions:
        return None
    keys = {key: filter_key(key) for key in needed_keys(decision.restrictions)}
    shape = kind.layout if needs_definition(decision) else None
    return Guard(shape, decision, keys, recall)
