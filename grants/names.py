"""Patterns over ROS names: `*` stands for one segment, `**` for one or more.

Segments are compared whole, so `/a` never covers `/ab` (the prefix confusion of ROSRV), and a
wildcard never stands for part of a segment. Names are absolute: relative and private (`~`)
names must be resolved before they come here, or they are refused. Names are ASCII: a look-alike
letter can never reach a decision.
"""

import re
from typing import Final

from grants.errors import PatternRefused

MAX_LENGTH: Final = 255

_SEGMENT: Final = r"[A-Za-z0-9_]+"
_NAME: Final = re.compile(rf"(?:/{_SEGMENT})+", re.ASCII)
_PATTERN: Final = re.compile(rf"(?:/(?:{_SEGMENT}|\*\*?))+", re.ASCII)


def check_name(text: str) -> str:
    """Return `text` if it is an absolute ROS name of at least one segment.

    Raises:
        PatternRefused: relative, private, empty, too long, or with other characters.
    """
    if len(text) > MAX_LENGTH or _NAME.fullmatch(text) is None:
        raise PatternRefused(
            f"not an absolute ROS name: {text[:MAX_LENGTH]!r}",
            "resolve relative and private names first, for example /robot1/scan",
        )
    return text


def check_pattern(text: str) -> str:
    """Return `text` if it is a name in which whole segments may be `*` or `**`.

    Raises:
        PatternRefused: as for `check_name`, or a wildcard beside other characters.
    """
    if len(text) > MAX_LENGTH or _PATTERN.fullmatch(text) is None:
        raise PatternRefused(
            f"not a name pattern: {text[:MAX_LENGTH]!r}",
            "* stands for one whole segment, ** for one or more: /robot1/*/scan, /robot1/**",
        )
    return text


def covers(pattern: str, name: str) -> bool:
    """Whether `pattern` stands for `name`, whole segment by whole segment.

    Raises:
        PatternRefused: either is not in its syntax.
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
        PatternRefused: either is not in its syntax.
    """
    check_pattern(pattern)
    check_name(name)
    return bool(_reach(_segments(pattern), _segments(name)))


def _segments(text: str) -> list[str]:
    return text[1:].split("/")


def _reach(pattern: list[str], name: list[str]) -> set[int]:
    """How many leading segments of `name` all of `pattern` can stand for; each at least one.

    A set of positions instead of backtracking: time is the product of the lengths, whatever
    the pattern (a chain of `**` would be exponential in a regular expression).
    """
    reached = {0}
    for segment in pattern:
        if segment == "**":
            reached = set(range(min(reached, default=len(name)) + 1, len(name) + 1))
        else:
            reached = {at + 1 for at in reached if at < len(name) and segment in ("*", name[at])}
    return reached
