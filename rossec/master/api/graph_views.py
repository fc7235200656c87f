"""What each caller that follows the graph was sent, so that it is sent only the changes. Pure.

A state is a set of facts, so a change is two sets, and all changes between two calls of one caller
are sent as one. Nothing is queued: a slow caller is updated less often, one without a stored view
is sent everything. An answer is bounded; `more` says that the rest follows at once.
"""

from collections import OrderedDict
from itertools import count
from typing import Final, NamedTuple, TypeAlias

BATCH: Final = 1024  # facts in one answer
MAX_VIEWS: Final = 4  # stored for one identity
_START: Final = 0  # the cursor of a caller without state

Fact: TypeAlias = tuple[str, str, str]
"""Kind, name and value: `("publisher", "/scan", "/laser")`, `("type", "/scan", "pkg/Type")`,
`("provider", "/reset", "rosrpc://...")`, `("node", "/laser", "http://...")`."""

View: TypeAlias = frozenset[Fact]


class _Sent(NamedTuple):
    """What a caller knows: facts, and what was said beside them."""

    facts: View
    beside: tuple[bytes, ...]


class GraphViews:
    """The views of all callers of one method.

    Args:
        instance: identifies this run of the master: cursors start again after a restart.
    """

    def __init__(self, instance: str) -> None:
        self._instance = instance
        self._cursors = count(_START + 1)
        self._views: OrderedDict[bytes, OrderedDict[int, _Sent]] = OrderedDict()

    def __len__(self) -> int:
        return sum(map(len, self._views.values()))

    def keep_only(self, thumbprints: frozenset[bytes]) -> None:
        """Discard the views of all other keys."""
        for key in self._views.keys() - thumbprints:
            del self._views[key]

    def answer(
        self,
        caller: bytes,
        seen: tuple[object, object],
        now: View,
        version: int,
        beside: tuple[bytes, ...] = (),
    ) -> dict[str, object]:
        """The changes since the caller's last view; the cursor stays if there are none.

        Args:
            caller: the thumbprint of its key.
            seen: the instance and the cursor it was answered last.
            now: what it may see now.
            version: of the state.
            beside: what the caller adds to the answer; a change of it is one of the answer.
        """
        instance, cursor = seen
        views = self._views.setdefault(caller, OrderedDict())
        cursor = cursor if isinstance(cursor, int) and instance == self._instance else _START
        known = views.get(cursor)
        old = frozenset() if known is None else known.facts
        added, removed = sorted(now - old), sorted(old - now)
        sent_added, sent_removed = added[:BATCH], removed[:BATCH]
        if known is None or added or removed or beside != known.beside:
            views.pop(cursor, None)
            cursor = next(self._cursors)
            view = (old | frozenset(sent_added)) - frozenset(sent_removed)
            views[cursor] = _Sent(view, beside)
            if len(views) > MAX_VIEWS:
                views.popitem(last=False)
        return {
            "instance": self._instance,
            "version": version % (1 << 31),  # XML-RPC's integers end there
            "cursor": cursor,
            "whole": known is None,
            "more": len(added) > BATCH or len(removed) > BATCH,
            "added": [list(fact) for fact in sent_added],
            "removed": [list(fact) for fact in sent_removed],
        }


def is_unchanged(answer: object, cursor: object) -> bool:
    """Whether an answer to a call with this cursor contains no change."""
    match answer:
        case [1, _, {"whole": False, "cursor": int() as now}]:
            return now == cursor
        case _:
            return False
