"""Patterns over ROS names: `*` stands for one segment, `**` for one or more.

Segments are compared whole, so `/a` never covers `/ab` (the prefix confusion of ROSRV), and a
wildcard never stands for part of a segment. Names are absolute: relative and private (`~`)
names must be resolved before they come here, or they are refused. Names are ASCII: a look-alike
letter can never reach a decision.
"""

from collections.abc import Sequence
from functools import lru_cache

from ca.errors import NameRefused
from ca.names import check_name
from grants.errors import PatternRefused

_WILDCARDS = ("*", "**")


def check_pattern(text: str) -> str:
    """Return `text` if it is a name in which whole segments may be `*` or `**`.

    Raises:
        PatternRefused: not a name (see `ca.names`), or a wildcard beside other characters.
    """
    segments = ["x" if segment in _WILDCARDS else segment for segment in text.split("/")]
    try:
        check_name("/".join(segments))
    except NameRefused as error:
        raise PatternRefused(
            f"not a name pattern: {error}",
            "* stands for one whole segment, ** for one or more: /robot1/*/scan, /robot1/**",
        ) from None
    return text


def covers(pattern: str, name: str) -> bool:
    """Whether `pattern` stands for `name`, whole segment by whole segment.

    Raises:
        PatternRefused, NameRefused: one of them is not in its syntax.
    """
    check_pattern(pattern)
    check_name(name)
    if "*" not in pattern:
        return pattern == name
    segments = _segments(name)
    return len(segments) in _reach(_segments(pattern), segments)


def covers_tree(pattern: str, name: str) -> bool:
    """Whether `pattern` stands for `name` or for something above it.

    For parameters: whoever may set `/a` sets every `/a/...` with it, because the value may be a
    tree. So a right to a key is always a right to all of its descendants, and never to a parent.

    Raises:
        PatternRefused, NameRefused: one of them is not in its syntax.
    """
    parts = _parts(pattern)
    check_name(name)
    return bool(_reach(parts, _segments(name)))


def covers_below(pattern: str, space: str) -> bool:
    """Whether `covers_tree` holds for every name below `space`, a name or `/` for all.

    Raises:
        PatternRefused: `pattern` is not in its syntax.
    """
    below = [*_space(space), _WILDCARDS[0]]  # a segment that no pattern spells out
    return bool(_reach(_parts(pattern), below))


def touches(pattern: str, space: str) -> bool:
    """Whether `covers_tree` holds for `space`, or for any name below it (`/`: for any at all).

    Raises:
        PatternRefused: `pattern` is not in its syntax.
    """
    name, reached = _space(space), {0}
    for segment in _parts(pattern):
        if len(name) in reached:  # what is left of the pattern stands for something below
            return True
        reached = _advance(reached, segment, name)
    return bool(reached)


def _space(text: str) -> list[str]:
    return [] if text == "/" else _segments(text)


def _segments(text: str) -> list[str]:
    return text[1:].split("/")


@lru_cache(maxsize=4096)
def _parts(pattern: str) -> tuple[str, ...]:
    """The segments of a pattern, which is asked about thousands of names."""
    return (*_segments(check_pattern(pattern)),)


def _reach(pattern: Sequence[str], name: list[str]) -> set[int]:
    """How many leading segments of `name` all of `pattern` can stand for; each at least one.

    A set of positions instead of backtracking: time is the product of the lengths, whatever
    the pattern (a chain of `**` would be exponential in a regular expression).
    """
    reached = {0}
    for segment in pattern:
        reached = _advance(reached, segment, name)
    return reached


def _advance(reached: set[int], segment: str, name: list[str]) -> set[int]:
    if segment == "**":
        return set(range(min(reached, default=len(name)) + 1, len(name) + 1))
    return {at + 1 for at in reached if at < len(name) and segment in ("*", name[at])}
