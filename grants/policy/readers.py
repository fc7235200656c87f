"""Readers of the parts of a policy: text, duration, name pattern, key thumbprint.

Each function takes a part and records a mistake if it is something else; it then returns None,
and reading continues with the rest of the file.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Final, Literal, TypeAlias

from ca.domains.aliases import is_alias, local_pattern
from ca.errors import NameRefused
from grants.model import MAX_RATE, Right
from grants.policy.mistakes import Mistakes, suggest
from grants.policy.own_names import NODE, check_rule_pattern, has_partial_star
from grants.policy.source import Part, YamlMapping, YamlScalar, YamlSequence

NEVER: Final = "never"
_UNITS: Final = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_DURATION: Final = re.compile(r"([1-9][0-9]{0,5})([smhdw])", re.ASCII)
_KEY: Final = re.compile(r"sha256:([0-9a-f]{64})", re.ASCII)
_PARTIAL_STAR: Final = (
    "* stands for a whole segment: list the nodes, or groups: {robots: [/robot1, /robot2]};"
    " anonymous nodes, /rviz_..., are one identity: /rviz"
)
_MAX_TEXT: Final = 1000

What: TypeAlias = Literal["mapping", "text", "list"]


def mapping(part: Part | None, what: str, mistakes: Mistakes) -> YamlMapping | None:
    """A mapping; a missing one is None and no mistake."""
    if part is None or isinstance(part, YamlMapping):
        return part
    mistakes.add(part, f"{what} must be a mapping", "write key: value")
    return None


def check_keys(
    part: YamlMapping,
    what: str,
    known: Collection[str],
    required: Collection[str],
    mistakes: Mistakes,
) -> None:
    """Record every unknown key, and every required one that is missing.

    `required` may be a mapping: to what is to be added for each.
    """
    for name, (key, _) in part.entries.items():
        if name not in known:
            mistakes.add(key, f"unknown key {name[:60]!r} in {what}", suggest(name, known))
    for name in required:
        if name not in part.entries:
            example = required[name] if isinstance(required, Mapping) else f"{name}: ..."
            mistakes.add(part, f"{what} has no {name!r}", f"add {example}")


def by_name(
    part: YamlMapping | None,
    what: str,
    read: Callable[[YamlScalar], str | None],
    mistakes: Mistakes,
) -> Iterator[tuple[str, YamlScalar, Part]]:
    """The entries of a mapping by what `read` makes of their keys: None if a key is a mistake.

    Keys of several spellings (`~/pose` and `"{node}/pose"`) are equal only then; the second of two
    would win without a word, so it is a mistake.
    """
    first: dict[str, YamlScalar] = {}
    for key, value in part.entries.values() if part is not None else ():
        name = read(key)
        if name is None:
            continue
        if name in first:
            again(key, f"{what}: {name[:80]!r}", first[name], mistakes)
            continue
        first[name] = key
        yield name, key, value


def again(key: Part, what: str, first: Part, mistakes: Mistakes) -> None:
    """Record that a key says what another has said before, whatever its spelling."""
    message = f"{what} a second time, first in {first.line}:{first.column}"
    mistakes.add(key, message, "keep one of them")


def text(part: Part | None, what: str, mistakes: Mistakes) -> str | None:
    """A non-empty text."""
    if part is None:
        return None
    if (
        isinstance(part, YamlScalar)
        and isinstance(part.value, str)
        and 0 < len(part.value) <= _MAX_TEXT
    ):
        return part.value
    mistakes.add(part, f"{what} must be text of 1 to {_MAX_TEXT} characters", "put it in quotes")
    return None


def items(part: Part | None) -> tuple[Part, ...]:
    """One part, or the parts of a list."""
    if part is None:
        return ()
    return part.items if isinstance(part, YamlSequence) else (part,)


def duration(
    part: Part | None, what: str, mistakes: Mistakes, *, never: bool = False
) -> int | None:
    """Seconds of `30s`, `15m`, `8h`, `7d`, `4w`; 0 for `never` if allowed."""
    if part is None:
        return None
    value = part.value if isinstance(part, YamlScalar) else None
    if never and value == NEVER:
        return 0
    match = _DURATION.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        choice = "write 30s, 15m, 8h, 7d or 4w" + (", or never" if never else "")
        mistakes.add(part, f"{what} is not a duration{_quoted(value)}", choice)
        return None
    return int(match[1]) * _UNITS[match[2]]


def pattern(part: Part | None, what: str, mistakes: Mistakes) -> str | None:
    """A name pattern, or own names of the asking node, as `{node}/...`."""
    value = _pattern_text(part, what, mistakes)
    if value is None or part is None:
        return None
    try:
        return check_rule_pattern(value)
    except NameRefused as error:
        mistakes.add(part, f"{what}: {error}", error.hint)
        return None


def _pattern_text(part: Part | None, what: str, mistakes: Mistakes) -> str | None:
    """The text of a pattern; `{node}` without quotes is a mapping of YAML."""
    if isinstance(part, YamlMapping) and list(part.entries) == [NODE[1:-1]]:
        mistakes.add(part, f"{what}: {NODE} without quotes", f'put it in quotes: "{NODE}"')
        return None
    return text(part, what, mistakes)


def own_pattern(part: Part | None, what: str, right: Right, mistakes: Mistakes) -> str | None:
    """A pattern of names of this domain; of names of others only the own graph is shown."""
    value = _pattern_text(part, what, mistakes)
    if value is None or part is None:
        return None
    foreign = ":" in value or is_alias(value)
    if foreign and (right is not Right.GRAPH or ":" in value):
        hint = "its own authority grants rights on it, by its name there"
        mistakes.add(part, f"{what}: {value[:80]!r} is a name of another domain", hint)
        return None
    return pattern(part, what, mistakes)


def subject(part: Part | None, what: str, mistakes: Mistakes) -> str | None:
    """A pattern of node names: of this domain, or `hospital:/rounds/*`, which becomes an alias."""
    value = text(part, what, mistakes)
    if value is None or part is None:
        return None
    if is_alias(value):
        hint = "LABEL:/NAME, for example hospital:/rounds/*"
        mistakes.add(part, f"{what}: write {value[:80]!r} with the label of the domain", hint)
        return None
    try:
        return local_pattern(value)
    except NameRefused as error:
        hint = _PARTIAL_STAR if has_partial_star(value) else error.hint or "LABEL:/NAME"
        mistakes.add(part, f"{what}: {error}", hint)
        return None


def key(part: Part | None, mistakes: Mistakes) -> bytes | None:
    """A key thumbprint, `sha256:` and 64 hexadecimal digits."""
    if part is None:
        return None
    value = part.value if isinstance(part, YamlScalar) else None
    match = _KEY.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        hint = "write sha256: and 64 hexadecimal digits, see: rossec ca show --json"
        mistakes.add(part, f"not a key thumbprint{_quoted(value)}", hint)
        return None
    return bytes.fromhex(match[1])


def number(part: Part | None, what: str, mistakes: Mistakes) -> float | None:
    """A number above zero."""
    if part is None:
        return None
    value = part.value if isinstance(part, YamlScalar) else None
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= MAX_RATE:
        return value
    mistakes.add(part, f"{what} must be a number above zero{_quoted(value)}", "for example 0.2")
    return None


def choice(part: Part | None, what: str, known: Collection[str], mistakes: Mistakes) -> str | None:
    """One of the known values."""
    if part is None:
        return None
    value = str(part.value) if isinstance(part, YamlScalar) else ""
    if value in known:
        return value
    mistakes.add(part, f"unknown {what}{_quoted(value)}", suggest(value, known))
    return None


def _quoted(value: object) -> str:
    return "" if value is None or value == "" else f": {str(value)[:60]!r}"
