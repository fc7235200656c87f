"""Patterns over ROS names: `*` stands for one segment, `**` for one or more.

Segments are compared whole, so `/a` never covers `/ab` (the prefix confusion of ROSRV), and a
wildcard never stands for part of a segment. Names are absolute: relative and private (`~`)
names must be resolved by the caller, or they are refused. Names are ASCII: homoglyphs are refused.

A tail pattern is `/rviz~/get_loggers`: `rviz~` stands for `rviz` and all that a wildcard tail of
`/rviz` covers (`ca.names`), in the last segment of one node's name and nowhere else. Only grants
to an identity with that tail have them; `check_pattern` refuses them.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

from ca.errors import NameRefused, PatternRefused
from ca.names import check_name, check_wildcard
from ca.suggestions import proposed_name

TAIL: Final = "~"
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
        raise PatternRefused(f"not a name pattern: {error}", _hint(text)) from None
    return text


def _hint(text: str) -> str:
    if ":/" in text:
        return _HINT_LABEL
    proposed = None if "*" in text else proposed_name(text)
    return _HINT if proposed is None else f"for example {proposed}; {_HINT}"


def check_tail_pattern(text: str) -> str:
    """Return `text` if it is a pattern, or a tail pattern.

    Raises:
        PatternRefused: neither; also a tail of a reserved name, which nothing may have.
    """
    base, mark, rest = text.partition(TAIL)
    if not mark:
        return check_pattern(text)
    try:
        check_wildcard(check_name(base))
    except NameRefused as error:
        raise PatternRefused(f"not a tail pattern: {error}", error.hint) from None
    if rest and not rest.startswith("/"):
        raise PatternRefused(f"not a tail pattern: {text[:80]!a}", "for example /rviz~/get_loggers")
    check_pattern(base + rest)
    return text


def tail_base(pattern: str) -> str | None:
    """The node whose tail a tail pattern is about; None for any other pattern."""
    base, mark, _ = pattern.partition(TAIL)
    return base if mark else None


def fits(segment: str, found: str) -> bool:
    """Whether one segment of a pattern, other than `**`, stands for the segment `found`.

    `found` may be one of a tail pattern: then whether it stands for all of its names.
    """
    if segment in ("*", found):
        return True
    return segment.endswith(TAIL) and _in_tail(segment[:-1], found.removesuffix(TAIL))


def _in_tail(base: str, segment: str) -> bool:
    """As `ca.names.covers` for an identity with a tail, of one segment of a checked name."""
    rest = segment.removeprefix(base)
    return segment == base or (rest != segment and len(rest) > 1 and rest.startswith("_"))


def covers(pattern: str, name: str) -> bool:
    """Whether `pattern` covers `name`, segment by segment; it may be a tail pattern.

    Raises:
        PatternRefused, NameRefused: invalid pattern or name.
    """
    check_tail_pattern(pattern)
    check_name(name)
    if "*" not in pattern and TAIL not in pattern:
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
    return [] if text == "/" else text[1:].split("/")


def _segments(text: str) -> list[str]:
    return text[1:].split("/")


@lru_cache(maxsize=4096)
def _pattern_segments(pattern: str) -> tuple[str, ...]:
    """The segments of a pattern, cached: a pattern is compared with thousands of names."""
    return (*_segments(check_tail_pattern(pattern)),)


def _match_ends(pattern: Sequence[str], name: list[str]) -> set[int]:
    """The numbers of leading segments of `name` that all of `pattern` can match.

    A set of positions instead of backtracking: time is the product of the lengths for every
    pattern (a chain of `**` would be exponential in a regular expression).
    """
    ends = {0}
    for segment in pattern:
        if not ends:
            break
        ends = _advance(ends, segment, name)
    return ends


def _advance(ends: set[int], segment: str, name: list[str]) -> set[int]:
    if segment == "**":
        return set(range(min(ends, default=len(name)) + 1, len(name) + 1))
    if TAIL in segment:
        return {at + 1 for at in ends if at < len(name) and fits(segment, name[at])}
    # As `fits`, without a call for each segment: the master checks thousands of names in one turn.
    return {at + 1 for at in ends if at < len(name) and segment in ("*", name[at])}
