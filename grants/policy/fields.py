"""Field filters and conditions in a policy: their notation, and whether they fit a type.

The notation is shorter than in a grant: `{round: 2.0}` for `{round: {step: 2.0}}`. The operators
are those of `grants.filters.operators`, so a policy supports exactly what its grants support.
"""

import re
from dataclasses import dataclass
from typing import Final

from grants.conditions.compile import check_syntax, compile_condition
from grants.errors import ConditionRefused, FilterRefused, GrantError
from grants.filters.compile import compile_filter
from grants.filters.layout import Array, Layout, Struct, Type
from grants.filters.operators import OPERATORS, treatment_for
from grants.filters.presets import preset
from grants.model import FilterRule, Scalar
from grants.policy.mistakes import Mistakes, SourcePosition, suggest
from grants.policy.source import Part, YamlMapping, YamlScalar, YamlSequence

_SHORT: Final = {
    "round": ("step",),
    "clamp": ("low", "high"),
    "truncate": ("length",),
    "redact": ("text",),
    "set": ("value",),
    "pixelate": ("block",),
    "hash": ("key",),
}
_FIELD: Final = re.compile(r"\bmsg((?:\.[A-Za-z]\w*)+)", re.ASCII)


@dataclass(frozen=True)
class FieldRule:
    """A filter rule and its position."""

    position: SourcePosition
    rule: FilterRule


@dataclass(frozen=True)
class ConditionRule:
    """A condition and its position; `reads_message` if it names fields of the message."""

    position: SourcePosition
    text: str
    reads_message: bool


def read_fields(part: YamlMapping, mistakes: Mistakes) -> tuple[FieldRule, ...]:
    """Read `{path: {operator: parameter}}`."""
    rules = (_read_field(key, value, mistakes) for key, value in part.entries.values())
    return tuple(rule for rule in rules if rule is not None)


def _read_field(key: YamlScalar, part: Part, mistakes: Mistakes) -> FieldRule | None:
    path = str(key.value)
    if not isinstance(part, YamlMapping) or len(part.entries) != 1:
        hint = "for example {round: 0.5} or {clear: true}"
        mistakes.add(part, f"{path}: exactly one operator per field", hint)
        return None
    [(operator, (position, value))] = part.entries.items()
    if operator not in OPERATORS:
        hint = suggest(operator, OPERATORS)
        mistakes.add(position, f"{path}: unknown operator {operator[:60]!r}", hint)
        return None
    parameters = _parameters(operator, value)
    if parameters is None:
        mistakes.add(value, f"{path}: invalid parameters of {operator}", _example(operator))
        return None
    try:
        rule = FilterRule(path, operator, tuple(sorted(parameters.items())))
        treatment_for(rule)
    except GrantError as error:
        mistakes.add(position, str(error), error.hint or _example(operator))
        return None
    return FieldRule(key, rule)


def _parameters(operator: str, part: Part) -> dict[str, Scalar] | None:
    """By name; a bare value is the operator's first parameter, a list all of them."""
    if isinstance(part, YamlMapping):
        named = {name: value for name, (_, value) in part.entries.items()}
        if not named or not all(isinstance(value, YamlScalar) for value in named.values()):
            return None
        return {name: value.value for name, value in named.items() if isinstance(value, YamlScalar)}
    short = _SHORT.get(operator, ())
    if isinstance(part, YamlScalar) and part.value is True and not short:
        return {}
    items = part.items if isinstance(part, YamlSequence) else (part,)
    if not short or len(items) != (len(short) if isinstance(part, YamlSequence) else 1):
        return None
    values = [item.value for item in items if isinstance(item, YamlScalar)]
    return dict(zip(short, values, strict=False)) if len(values) == len(items) else None


def _example(operator: str) -> str:
    match _SHORT.get(operator, ()):
        case ():
            return f"write {{{operator}: true}}"
        case (name,):
            return f"write {{{operator}: {name.upper()}}} or {{{operator}: {{{name}: ...}}}}"
        case names:
            return f"write {{{operator}: [{', '.join(name.upper() for name in names)}]}}"


def check_fields(
    layout: Layout, rules: tuple[FieldRule, ...], position: SourcePosition, mistakes: Mistakes
) -> bool:
    """Whether the rules fit messages of `layout`: each alone, then together."""
    fits = True
    for item in rules:
        fits = _fits(layout, (item,), item.position, mistakes) and fits
    return fits and _fits(layout, rules, position, mistakes)


def _fits(
    layout: Layout, rules: tuple[FieldRule, ...], position: SourcePosition, mistakes: Mistakes
) -> bool:
    try:
        compile_filter(layout, (item.rule for item in rules))
    except GrantError as error:
        hint = suggest_field(layout, rules[0].rule.path)
        mistakes.add(position, f"{layout.type_name}: {error}", hint or error.hint)
        return False
    return True


def check_preset(layout: Layout, name: str, position: SourcePosition, mistakes: Mistakes) -> bool:
    """Whether the preset `name` exists for messages of `layout`."""
    try:
        preset(name).restriction(layout)
    except FilterRefused as error:
        mistakes.add(position, f"{name}: {error}", error.hint)
        return False
    return True


def read_condition(part: Part, mistakes: Mistakes) -> ConditionRule | None:
    """Read one condition: its syntax is checked, not yet its types."""
    text = part.value if isinstance(part, YamlScalar) else None
    if not isinstance(text, str):
        mistakes.add(part, "a condition must be text", "put it in single quotes")
        return None
    try:
        check_syntax(text)
    except ConditionRefused as error:
        mistakes.add(part, str(error), error.hint or "see docs/spec/policy.md")
        return None
    try:
        compile_condition(None, text)
    except ConditionRefused as error:
        if _FIELD.search(text) is None:
            mistakes.add(part, str(error), error.hint)
            return None
        return ConditionRule(part, text, reads_message=True)
    return ConditionRule(part, text, reads_message=False)


def check_condition(layout: Layout, condition: ConditionRule, mistakes: Mistakes) -> bool:
    """Whether the condition fits messages of `layout`."""
    try:
        compile_condition(layout, condition.text)
    except ConditionRefused as error:
        paths = (found[1][1:] for found in _FIELD.finditer(condition.text))
        hints = [hint for path in paths if (hint := suggest_field(layout, path))]
        message = f"{layout.type_name}: {error}"
        mistakes.add(condition.position, message, hints[0] if hints else error.hint)
        return False
    return True


def suggest_field(layout: Layout, path: str) -> str:
    """For an invalid path: a hint with the most similar field; else empty."""
    kind: Type = layout.root
    for step in path.split("."):
        while isinstance(kind, Array):
            kind = kind.element
        if not isinstance(kind, Struct):
            return ""
        members = dict(kind.fields)
        name = step.removesuffix("[*]")
        if name not in members:
            return suggest(name, members)
        kind = members[name]
    return ""
