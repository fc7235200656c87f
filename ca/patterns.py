"""Patterns over ROS names: `*` stands for one segment, `**` for one or more.

Segments are compared whole, so `/a` never covers `/ab` (the prefix confusion of ROSRV), and a
wildcard never stands for part of a segment. Names are absolute: relative and private (`~`)
names must be resolved by the caller, or they are refused. Names are ASCII: homoglyphs are refused.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from ca.errors import NameRefused, PatternRefused
from ca.names import check_name

_WILDCARDS = ("*", "**")
_HINT: Final = "* stands for one whole segment, ** for one or more: /robot1/*/scan, /robot1/**"
_HINT_LABEL: Final = "a pattern is of one domain's own names, which have no label: /robot1/**"


def check_pattern(text: str) -> str:
    """Return `text` if it is a name in which whole segments may be `*` or `**`.

    Raises:
        PatternRefused: not a name (see `ca.names`), or a wildcard beside other characters.
    """
    segments = ["x" if segment in _WILDCARDS else segment for segment in text.split("/")]
    try:
        check_name("/".join(segments))
    except NameRefused as error:
        hint = _HINT_LABEL if ":/" in text else _HINT
        raise PatternRefused(f"not a name pattern: {error}", hint) from None
    return text


def covers(pattern: str, name: str) -> bool:
    """Whether `pattern` covers `name`, segment by segment.

    Raises:
        PatternRefused, NameRefused: invalid pattern or name.
    """
    check_pattern(pattern)
    check_name(name)
    if "*" not in pattern:
        return pattern == name
    segments = _segments(name)
    return len(segments) in _match_ends(_segments(pattern), segments)


def covers_tree(pattern: str, name: str) -> bool:
    """Whether `pattern` covers `name` or a parent of it.

    For parameters: setting `/a` also sets every `/a/...`, because the value may be a tree. So a
    right to a key is always a right to all of its descendants, and never to a parent.

    Raises:
        PatternRefused, NameRefused: invalid pattern or name.
    """
    pattern_segments = _pattern_segments(pattern)
    check_name(name)
    return bool(_match_ends(pattern_segments, _segments(name)))


def covers_below(pattern: str, namespace: str) -> bool:
    """Whether `covers_tree` is true for every name below `namespace`; `/` is the root.

    Raises:
        PatternRefused: invalid pattern.
    """
    below = [*_namespace_segments(namespace), _WILDCARDS[0]]  # a segment that only wildcards match
    return bool(_match_ends(_pattern_segments(pattern), below))


def touches(pattern: str, namespace: str) -> bool:
    """Whether `covers_tree` is true for `namespace` or any name below it; `/` is the root.

    Raises:
        PatternRefused: invalid pattern.
    """
    name, ends = _namespace_segments(namespace), {0}
    for segment in _pattern_segments(pattern):
        if len(name) in ends:  # the rest of the pattern covers names below
            return True
        ends = _advance(ends, segment, name)
    return bool(ends)


def _namespace_segments(text: str) -> list[str]:
    return [] if text == "/" else _segments(text)


def _segments(text: str) -> list[str]:
    return text[1:].split("/")


@lru_cache(maxsize=4096)
def _pattern_segments(pattern: str) -> tuple[str, ...]:
    """The segments of a pattern, cached: a pattern is compared with thousands of names."""
    return (*_segments(check_pattern(pattern)),)


def _match_ends(pattern: Sequence[str], name: list[str]) -> set[int]:
    """The numbers of leading segments of `name` that all of `pattern` can match.

    A set of positions instead of backtracking: time is the product of the lengths for every
    pattern (a chain of `**` would be exponential in a regular expression).
    """
    ends = {0}
    for segment in pattern:
        ends = _advance(ends, segment, name)
    return ends


def _advance(ends: set[int], segment: str, name: list[str]) -> set[int]:
    if segment == "**":
        return set(range(min(ends, default=len(name)) + 1, len(name) + 1))
    return {at + 1 for at in ends if at < len(name) and segment in ("*", name[at])}
