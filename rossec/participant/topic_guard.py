"""The guard that applies restrictions to the messages of one connection. Pure.

Each side applies those of the other: a publisher the subscriber's, before a message is sent; a
subscriber the publisher's, before a message is accepted. A restricted peer is not trusted to obey
them, nor with the definition of its messages (`definitions`).
"""

from collections.abc import Callable

from grants.decision import Decision
from grants.guard import Guard, needed_keys
from grants.memory import MemoryScope
from rossec.participant.definitions import Definition, needs_definition

FilterKey = Callable[[str], bytes]


def guard_for(
    kind: Definition, decision: Decision, filter_key: FilterKey, memory: MemoryScope
) -> Guard | None:
    """The guard for messages of `kind`; None: nothing to apply.

    `memory` finds what earlier connections of the same key have used up. Without a guard, the
    watchdog still closes the connection when the right expires.

    Raises:
        ConnectionHeaderRefused, DefinitionRefused: `kind` has no valid definition.
        GrantError: the restrictions are for another type.
    """
    if not decision.restrictions:
        return None
    keys = {key: filter_key(key) for key in needed_keys(decision.restrictions)}
    shape = kind.layout if needs_definition(decision) else None
    return Guard(shape, decision, keys, memory)
