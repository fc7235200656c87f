"""Patterns of rules: does one include the other, do they intersect, and the asking node's own names.

Needed where a right is requested for a whole pattern: `/a/**` may only be granted if every name in it is
allowed, and not if one of them is denied.

`{node}` (`~/pose` for `{node}/pose`) stands for the whole certified name of the node that asks, so it stands
first: what results is that name or one below it, never one beside it. With an anonymous suffix it stands for
every name of the suffix too, as a tail pattern (`ca.names`), which only its own grants can have.
"""

import re
from collections.abc import Callable, Collection
from functools import lru_cache
from typing import Final

from ca.errors import NameRefused, PatternRefused
from ca.names import TAIL, check_pattern, check_tail_pattern, fits, is_alias
from ca.names import covers as names_cover
from grants.model import TREE_RIGHTS, Right

NODE: Final = "{node}"
_SHORT: Final = "~"
BEGINS_TOPIC: Final = ("/", _SHORT, "{")  # of a key that is a topic, and not a field or a word
_HINT: Final = 'the asking node\'s own names are ~/pose, or in quotes "{node}/pose" and "{node}"'
_HINT_FIRST: Final = '{node} is the whole name of the asking node, so it stands first: "{node}/pose"'
_BRACES: Final = re.compile(r"\{[^{}]*\}|[{}]")
_ANY: Final = "*"  # a segment that only wildcards match


def segments(pattern: str) -> tuple[str, ...]:
    return tuple(pattern[1:].split("/"))


# Names are infinite, so both are decided on the automata of the patterns: a position in each,
# moved segment by segment.
@lru_cache(maxsize=4096)
def includes(outer: str, inner: str, *, tree: bool = False) -> bool:
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
    return _walk(segments(pattern), segments(name), lambda a, b: a or b)


def overlaps(pattern: str, right: Right, requested: str) -> bool:
    return intersects_tree(pattern, requested) if right & TREE_RIGHTS else intersects(pattern, requested)


def gives(pattern: str, right: Right, requested: str) -> bool:
    return includes(pattern, requested, tree=bool(right & TREE_RIGHTS))


def _walk(one: tuple[str, ...], other: tuple[str, ...], ends: Callable[[bool, bool], bool]) -> bool:
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


def is_own(text: str) -> bool:
    return text.startswith(NODE)


def check_rule_pattern(text: str) -> str:
    """Return a pattern of a rule: as `check_pattern`, or own names, which begin with `{node}`."""
    if text == NODE:
        return text
    head, slash, rest = text.partition("/")
    if slash and head in (_SHORT, NODE) and not _is_marked(rest):
        return NODE + check_pattern(f"/{rest}")
    if _is_marked(text):
        words = [word for word in _BRACES.findall(text) if word != NODE]
        if text == _SHORT:
            fault, hint = "is no name", f'write "{NODE}"'
        elif words:
            fault, hint = f"has {words[0][:40]!r}, which stands for nothing", _HINT
        elif _SHORT not in text:
            fault, hint = "has {node} where it does not stand for a whole name", _HINT_FIRST
        else:
            private = re.fullmatch(r"~([A-Za-z][A-Za-z0-9_/*]*)", text, re.ASCII)
            fault = "has a ~ that is not before the first /"
            hint = f"write ~/{private[1]}" if private is not None else _HINT
        raise PatternRefused(f"not a name pattern: {text[:80]!r} {fault}", hint)
    if has_partial_star(text):
        raise PatternRefused(
            f"not a name pattern: {text[:80]!r} has a * for part of a segment",
            "* stands for one whole segment; write the names one by one, or, where each node shall"
            " have its own, ~/... with who: its group",
        )
    return check_pattern(text)


def resolve(pattern: str, node: str, *, tail: bool) -> str | None:
    """What a pattern of a rule is for the node called `node`; None: no name at all.

    A foreigner has no own names here: its own authority grants rights on them.
    """
    if not is_own(pattern):
        return pattern
    if is_alias(node):
        return None
    found = node + TAIL * tail + pattern.removeprefix(NODE)
    try:
        return check_tail_pattern(found)
    except NameRefused:  # longer than a name may be
        return None


def any_node(pattern: str) -> str:
    return f"/**{pattern.removeprefix(NODE)}" if is_own(pattern) else pattern


def own_form(name: str, node: str, *, tail: bool = False) -> str | None:
    """How a rule writes `name` as an own name of the node called `node`; None: it is not one."""
    depth = node.count("/") + 1
    segments = name.split("/")
    if is_alias(node) or not names_cover(node, "/".join(segments[:depth]), wildcard=tail):
        return None
    return "/".join((NODE, *segments[depth:]))


def speaks_for_others(pattern: str, nodes: Collection[str | None]) -> str | None:
    # What to write instead of a pattern that gives several nodes each other's names, else None: `/*/pose`
    # for more than one node lets each of them be `/robot2/pose`, and it is `{node}/pose` that was meant.
    head, _, rest = pattern[1:].partition("/")
    several = len(nodes) > 1 or any(node is None or "*" in node for node in nodes)
    if is_own(pattern) or head not in ("*", "**") or not several:
        return None
    return f"{NODE}/{rest}" if rest else f"{NODE}/**"


def has_partial_star(text: str) -> bool:
    """Whether `/robot*/pose` is written: it would cover `/robotics_of_eve` too."""
    return any("*" in segment and segment.strip("*") for segment in text.split("/"))


def _is_marked(text: str) -> bool:
    return any(mark in text for mark in (*"{}", _SHORT))
