"""Two patterns side by side: does one lie within the other, do they meet at all?

Needed where a whole pattern is asked for: a right to `/a/**` may only be given if every name in
it may be had, and not if one of them is denied. Names are infinite, so both are decided on the
automata of the patterns: a position in each, moved segment by segment.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Final

from grants.model import TREE_RIGHTS, Right

_ANY: Final = "*"  # as a letter: a segment no pattern spells out


def segments(pattern: str) -> tuple[str, ...]:
    """The segments of a checked pattern."""
    return tuple(pattern[1:].split("/"))


@lru_cache(maxsize=4096)
def includes(outer: str, inner: str, *, tree: bool = False) -> bool:
    """Whether every name `inner` stands for is one `outer` stands for (`tree`: or lies below)."""
    wide, narrow = segments(outer), segments(inner)
    seen: set[tuple[int, frozenset[int]]] = set()
    todo = [(0, frozenset({0}))]
    while todo:
        state = todo.pop()
        if state in seen:
            continue
        seen.add(state)
        at, reached = state
        if tree and len(wide) in reached:
            continue  # whatever follows lies below
        if at == len(narrow) and len(wide) not in reached:
            return False
        for letter, after in _moves(narrow, at):
            todo.append((after, _step(wide, reached, letter)))
    return True


@lru_cache(maxsize=4096)
def intersects(one: str, other: str) -> bool:
    """Whether some name lies under both."""
    return _walk(segments(one), segments(other), lambda a, b: a and b)


@lru_cache(maxsize=4096)
def intersects_tree(pattern: str, name: str) -> bool:
    """Whether some key lies under `pattern` or below it, and also under `name` or below it."""
    return _walk(segments(pattern), segments(name), lambda a, b: a or b)


def concerns(pattern: str, right: Right, asked: str) -> bool:
    """Whether a rule about `pattern` touches any of what is `asked`: enough for a denial."""
    return intersects_tree(pattern, asked) if right & TREE_RIGHTS else intersects(pattern, asked)


def gives(pattern: str, right: Right, asked: str) -> bool:
    """Whether a rule about `pattern` gives all of what is `asked`."""
    return includes(pattern, asked, tree=bool(right & TREE_RIGHTS))


def _walk(one: tuple[str, ...], other: tuple[str, ...], ends: Callable[[bool, bool], bool]) -> bool:
    """Move through both at once; True where `ends(one at its end, other at its end)`."""
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
        for letter, after in _moves(one, here):
            for other_letter, other_after in _moves(other, there):
                if letter == other_letter or _ANY in (letter, other_letter):
                    todo.append((after, other_after))
    return False


def _moves(pattern: tuple[str, ...], at: int) -> list[tuple[str, int]]:
    """Which segment may come at a position, and where it leads; `**` may stay."""
    moves: list[tuple[str, int]] = []
    if at < len(pattern):
        moves.append((_ANY if pattern[at] == "**" else pattern[at], at + 1))
    if at > 0 and pattern[at - 1] == "**":
        moves.append((_ANY, at))
    return moves


def _step(pattern: tuple[str, ...], reached: frozenset[int], letter: str) -> frozenset[int]:
    return frozenset(
        after for at in reached for want, after in _moves(pattern, at) if want in (_ANY, letter)
    )
