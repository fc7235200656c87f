"""The asking node's own names in a rule: `{node}`, `{node}/pose`, `{node}/**`; `~/pose` for short.

`{node}` stands for the whole certified name of the node that asks, so it stands first, alone or
before a `/`: what results is that name or a name below it, never a name beside it. Of an identity
with a wildcard tail it stands for every name of the tail too, as a tail pattern (`ca.patterns`),
which only its own grants can have. A node of another domain has no own names here.
"""

import re
from collections.abc import Collection
from typing import Final

from ca.domains.aliases import is_alias
from ca.errors import NameRefused, PatternRefused
from ca.names import covers as names_cover
from ca.patterns import TAIL, check_pattern, check_tail_pattern

NODE: Final = "{node}"
_SHORT: Final = "~"
BEGINS_TOPIC: Final = ("/", _SHORT, "{")  # of a key that is a topic, and not a field or a word
_HINT: Final = 'the asking node\'s own names are ~/pose, or in quotes "{node}/pose" and "{node}"'
_HINT_FIRST: Final = (
    '{node} is the whole name of the asking node, so it stands first: "{node}/pose"'
)
_BRACES: Final = re.compile(r"\{[^{}]*\}|[{}]")


def is_own(text: str) -> bool:
    """Whether a pattern that `check_rule_pattern` returned stands for the asking node's names."""
    return text.startswith(NODE)


def check_rule_pattern(text: str) -> str:
    """Return a pattern of a rule: as `check_pattern`, or own names, which begin with `{node}`.

    Raises:
        PatternRefused: neither; also other words in braces, and `{node}` or `~` elsewhere.
    """
    if text == NODE:
        return text
    head, slash, rest = text.partition("/")
    if slash and head in (_SHORT, NODE) and not _is_marked(rest):
        return NODE + check_pattern(f"/{rest}")
    if _is_marked(text):
        raise PatternRefused(f"not a name pattern: {text[:80]!r} {_fault(text)}", _hint(text))
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
    """The names that a pattern of a rule has for some node or other, as a pattern."""
    return f"/**{pattern.removeprefix(NODE)}" if is_own(pattern) else pattern


def own_form(name: str, node: str, *, tail: bool = False) -> str | None:
    """How a rule writes `name` as an own name of the node called `node`; None: it is not one."""
    depth = node.count("/") + 1
    segments = name.split("/")
    if is_alias(node) or not names_cover(node, "/".join(segments[:depth]), wildcard=tail):
        return None
    return "/".join((NODE, *segments[depth:]))


def speaks_for_others(pattern: str, nodes: Collection[str | None]) -> str | None:
    """What to write instead of a pattern that gives several nodes each other's names, if any.

    `/*/pose` for more than one node lets each of them be `/robot2/pose`: it is `{node}/pose` that
    was meant. None for every other pattern, and where the rule is for one node only.

    Args:
        nodes: of the subjects of the rule: names or patterns; None for any with a key.
    """
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


def _fault(text: str) -> str:
    if text == _SHORT:
        return "is no name"
    words = [word for word in _BRACES.findall(text) if word != NODE]
    if words:
        return f"has {words[0][:40]!r}, which stands for nothing"
    if _SHORT in text:
        return "has a ~ that is not before the first /"
    return "has {node} where it does not stand for a whole name"


def _hint(text: str) -> str:
    if text == _SHORT:
        return f'write "{NODE}"'
    words = [word for word in _BRACES.findall(text) if word != NODE]
    if words:
        return _HINT
    if _SHORT not in text:
        return _HINT_FIRST
    private = re.fullmatch(r"~([A-Za-z][A-Za-z0-9_/*]*)", text, re.ASCII)
    return f"write ~/{private[1]}" if private is not None else _HINT
