"""The graph of a master as a watcher knows it from the answers of `rossec.watchGraph`. Pure.

The thesis (4.2) has a watcher compare versions to notice a restarted master; here each answer has
an instance id of the master, and a master that does not know the watcher sends the whole graph.
"""

from typing import Final, NamedTuple

from rossec.errors import AnswerMalformed

METHOD: Final = "rossec.watchGraph"

Fact = tuple[str, str, str]
"""Kind, name and value, as `rossec.master.api.watch_calls` has them."""


class ObservedChange(NamedTuple):
    """The changes in one answer.

    Args:
        restarted: the master restarted, or no longer knows this watcher.
        more: call again at once.
    """

    added: tuple[Fact, ...]
    removed: tuple[Fact, ...]
    restarted: bool
    more: bool


class GraphView:
    """The graph as one watcher knows it."""

    def __init__(self) -> None:
        self.facts: frozenset[Fact] = frozenset()
        self.version = -1
        self.instance = ""
        self._cursor = 0

    @property
    def next_params(self) -> tuple[str, int]:
        """The parameters of the next call."""
        return self.instance, self._cursor

    def take(self, answer: object) -> ObservedChange:
        """Take over an answer; facts that are sent again but have not changed are not reported.

        Raises:
            AnswerMalformed: it is invalid.
        """
        match answer:
            case {
                "instance": str() as instance, "version": int() as version,
                "cursor": int() as cursor, "whole": bool() as whole, "more": bool() as more,
                "added": list() as added, "removed": list() as removed,
            }:  # fmt: skip
                new, old = facts_of(added), facts_of(removed)
            case _:
                raise AnswerMalformed("a graph update that is malformed")
        base = frozenset() if whole else self.facts
        known = self.facts
        self.facts = (base | new) - old
        restarted = whole and self.instance != ""
        self.instance, self.version, self._cursor = instance, version, cursor
        return ObservedChange(
            tuple(sorted(self.facts - known)), tuple(sorted(known - self.facts)), restarted, more
        )


def facts_of(rows: list[object]) -> frozenset[Fact]:
    """The facts in a part of an answer.

    Raises:
        AnswerMalformed: something else.
    """
    found: set[Fact] = set()
    for row in rows:
        match row:
            case [str() as kind, str() as name, str() as value]:
                found.add((kind, name, value))
            case _:
                raise AnswerMalformed("a graph update that is malformed")
    return frozenset(found)
