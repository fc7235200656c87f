"""Comparison of two patterns: does one include the other, do they intersect?

Needed where a right is requested for a whole pattern: `/a/**` may only be granted if every name in
it is allowed, and not if one of them is denied. Names are infinite, so both are decided on the
automata of the patterns: a position in each, moved segment by segment. Both may be tail patterns
(`ca.patterns`): their segment `rviz~` is included only by one of the same tail, or by a wildcard.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Final

from ca.patterns import fits
from grants.model import TREE_RIGHTS, Right

_ANY: Final = "*"  # a segment that only wildcards match


def segments(pattern: str) -> tuple[str, ...]:
    """The segments of a checked pattern."""
    return tuple(pattern[1:].split("/"))


@lru_cache(maxsize=4096)
def includes(outer: str, inner: str, *, tree: bool = False) -> bool:
    """Whether `outer` covers every name that `inner` covers (`tree`: or a parent of it)."""
    wide, narrow = segments(outer), segments(inner)
    seen: set[tuple[int, frozenset[int]]] = set()
    todo = [(0, frozenset({0}))]
    while todo:
        state = todo.pop()
        if state in seen:
            continue
        seen.add(state)
        position, reached = state
        if tree and len(wide) in reached:
            continue  # all further names are below
        if position == len(narrow) and len(wide) not in reached:
            return False
        for segment, after in _moves(narrow, position):
            todo.append((after, _step(wide, reached, segment)))
    return True


@lru_cache(maxsize=4096)
def intersects(one: str, other: str) -> bool:
    """Whether both cover a common name."""
    return _walk(segments(one), segments(other), lambda a, b: a and b)


@lru_cache(maxsize=4096)
def intersects_tree(pattern: str, name: str) -> bool:
    """Whether the trees below names of `pattern` and of `name` have a common key."""
    return _walk(segments(pattern), segments(name), lambda a, b: a or b)


def overlaps(pattern: str, right: Right, requested: str) -> bool:
    """Whether a rule on `pattern` overlaps with `requested`: enough for a denial."""
    return (
        intersects_tree(pattern, requested)
        if right & TREE_RIGHTS
        else intersects(pattern, requested)
    )


def gives(pattern: str, right: Right, requested: str) -> bool:
    """Whether a rule on `pattern` gives all of `requested`."""
    return includes(pattern, requested, tree=bool(right & TREE_RIGHTS))


def _walk(one: tuple[str, ...], other: tuple[str, ...], ends: Callable[[bool, bool], bool]) -> bool:
    """Advance in both at once; True if `ends(end of one reached, end of other reached)`."""
    seen: set[tuple[int, int]] = set()
    todo = [(0, 0)]
    while todo:
        state = todo.pop()
        if state in seen:
            continue
        seen.add(state)
        here, there = state
        if here + there and ends(here == len(one), there == len(other)):
            return True
        for segment, after in _moves(one, here):
            for other_segment, other_after in _moves(other, there):
                if fits(segment, other_segment) or fits(other_segment, segment):
                    todo.append((after, other_after))
    return False


def _moves(pattern: tuple[str, ...], position: int) -> list[tuple[str, int]]:
    """The segments possible at a position, and the next position; `**` may stay."""
    moves: list[tuple[str, int]] = []
    if position < len(pattern):
        moves.append((_ANY if pattern[position] == "**" else pattern[position], position + 1))
    if position > 0 and pattern[position - 1] == "**":
        moves.append((_ANY, position))
    return moves


def _step(pattern: tuple[str, ...], reached: frozenset[int], segment: str) -> frozenset[int]:
    return frozenset(
        after
        for position in reached
        for expected, after in _moves(pattern, position)
        if fits(expected, segment)
    )
