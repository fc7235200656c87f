"""The restrictions of a rule: filters, conditions, `limit` and `see`; whether they fit a type.

The notation is shorter than in a grant: `{round: 2.0}` for `{round: {step: 2.0}}`. Of `see` (`{position:
room, image: no}`, or the same by topic) what is said is an upper limit; a word that is not mentioned is shown
as it is, unless it gives away one that is.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple, TypeVar

from ca.encoding import MAX_SIZE
from ca.errors import HintedError
from grants import document
from grants.conditions import check_syntax, compile_condition
from grants.errors import ConditionRefused, FilterRefused, GrantError
from grants.filters.compile import compile_filter, preset
from grants.filters.layout import Array, Layout, Struct, Type
from grants.filters.operators import OPERATORS, treatment_for
from grants.limits import MAX_PAD, MAX_SLOT, MIN_PAD, MIN_SLOT, is_body
from grants.model import FilterRule, Permission, Right, Scalar
from grants.policy import source
from grants.policy.model import Vocabulary
from grants.policy.names import BEGINS_TOPIC
from grants.policy.source import Part, YamlMapping, YamlScalar, YamlSequence, suggest
from grants.vocabulary.contents import EXACT, LEVELS, NO, DataWord
from grants.vocabulary.levels import Levels, Resolved, resolve

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
_KEYS: Final = ("rate", "slot", "body", "pad")
MAX_ENTRIES: Final = 64  # of one grant, where what it says can be divided
_MAX_TEXT: Final = 8 * 1024  # of one grant as text, which is longer than its encoding
MAX_SCOPE: Final = MAX_SIZE - 2048  # the rest of a grant: names, keys, times and the signature
_Right = TypeVar("_Right")


@dataclass(frozen=True)
class FieldRule:
    position: Part
    rule: FilterRule


@dataclass(frozen=True)
class ConditionRule:
    position: Part
    text: str
    reads_message: bool


def read_fields(part: YamlMapping) -> tuple[FieldRule, ...]:
    rules: list[FieldRule] = []
    for key, treatment in part.entries.values():
        path = str(key.value)
        if not isinstance(treatment, YamlMapping) or len(treatment.entries) != 1:
            hint = "for example {round: 0.5} or {clear: true}"
            treatment.mistake(f"{path}: exactly one operator per field", hint)
            continue
        [(operator, (position, value))] = treatment.entries.items()
        if operator not in OPERATORS:  # those of grants, so a policy supports exactly what its grants support
            position.mistake(f"{path}: unknown operator {operator[:60]!r}", suggest(operator, OPERATORS))
            continue
        parameters = _parameters(operator, value)
        if parameters is None:
            value.mistake(f"{path}: invalid parameters of {operator}", _example(operator))
            continue
        try:
            rule = FilterRule(path, operator, tuple(sorted(parameters.items())))
            treatment_for(rule)
        except GrantError as error:
            position.mistake(str(error), error.hint or _example(operator))
        else:
            rules.append(FieldRule(key, rule))
    return tuple(rules)


def _parameters(operator: str, part: Part) -> dict[str, Scalar] | None:
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


def check_fields(layout: Layout, rules: tuple[FieldRule, ...], position: Part) -> bool:
    single = [_fits(layout, (item,), item.position) for item in rules]
    return all(single) and _fits(layout, rules, position)


def _fits(layout: Layout, rules: tuple[FieldRule, ...], position: Part) -> bool:
    try:
        compile_filter(layout, (item.rule for item in rules))
    except GrantError as error:
        hint = suggest_field(layout, rules[0].rule.path)
        position.mistake(f"{layout.type_name}: {error}", hint or error.hint)
        return False
    return True


def check_preset(layout: Layout, name: str, position: Part) -> bool:
    try:
        preset(name).restriction(layout)
    except FilterRefused as error:
        position.mistake(f"{name}: {error}", error.hint)
        return False
    return True


def read_condition(part: Part) -> ConditionRule | None:
    # Its syntax is checked, not yet its types.
    text = part.value if isinstance(part, YamlScalar) else None
    if not isinstance(text, str):
        part.mistake("a condition must be text", "put it in single quotes")
        return None
    try:
        check_syntax(text)
    except ConditionRefused as error:
        part.mistake(str(error), error.hint or "see docs/spec/policy.md")
        return None
    try:
        compile_condition(None, text)
    except ConditionRefused as error:
        if _FIELD.search(text) is None:
            part.mistake(str(error), error.hint)
            return None
        return ConditionRule(part, text, reads_message=True)
    return ConditionRule(part, text, reads_message=False)


def check_condition(layout: Layout, condition: ConditionRule) -> bool:
    try:
        compile_condition(layout, condition.text)
    except ConditionRefused as error:
        paths = (found[1][1:] for found in _FIELD.finditer(condition.text))
        hints = [hint for path in paths if (hint := suggest_field(layout, path))]
        condition.position.mistake(f"{layout.type_name}: {error}", hints[0] if hints else error.hint)
        return False
    return True


def suggest_field(layout: Layout, path: str) -> str:
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


class _Whole(NamedTuple):
    key: str
    wrong: str
    units: str
    least: int
    most: int


_SLOT: Final = _Whole("slot", "a slot of {:g} s", "seconds", MIN_SLOT, MAX_SLOT)
_PAD: Final = _Whole("pad", "padding to {:g} bytes", "bytes", MIN_PAD, MAX_PAD)


class Limit(NamedTuple):
    rate: float | None = None
    slot: int | None = None
    body: str | None = None
    pad: int | None = None


def read_limit(part: Part | None, topics: list[str], name: str, *, seen: bool = True) -> Limit:
    # `seen`: the rule subscribes to the topics; what it only publishes has no slot and no body.
    mapping = source.mapping(part, f"limit of rule {name}")
    if mapping is None:
        return Limit()
    source.check_keys(mapping, f"limit of rule {name}", _KEYS, ())
    given = mapping.entries.keys() & set(_KEYS)
    if not topics:
        mapping.mistake(f"rule {name}: nothing to limit", "add a subscribe or publish right")
    elif not given:
        mapping.mistake(f"rule {name}: an empty limit", "for example {rate: 1}")
    if not seen and given & {"slot", "body"}:
        message = f"rule {name}: a slot or a body is of what is subscribed to"
        mapping.mistake(message, "a rule that only publishes may have a rate")
    body = source.text(mapping.get("body"), "body") if "body" in given else None
    if body is not None and not is_body(body):
        hint = "a letter, then at most 63 letters, digits, - and _"
        mapping.entries["body"][1].mistake(f"not a name of a body: {body[:40]!r}", hint)
        body = None
    return Limit(
        source.number(mapping.get("rate"), "rate") if "rate" in given else None,
        _whole(mapping.get("slot"), _SLOT) if "slot" in given else None,
        body,
        _whole(mapping.get("pad"), _PAD) if "pad" in given else None,
    )


def _whole(part: Part | None, kind: _Whole) -> int | None:
    found = source.number(part, kind.key)
    if found is None:
        return None
    if float(found).is_integer() and kind.least <= found <= kind.most:
        return int(found)
    if part is not None:
        part.mistake(kind.wrong.format(found), f"whole {kind.units}, from {kind.least} to {kind.most}")
    return None


@dataclass(frozen=True)
class TopicLevels:
    position: Part
    levels: Levels = field(default_factory=dict)


def read_see(part: Part | None, topics: Sequence[str], name: str) -> dict[str, TopicLevels]:
    mapping = source.mapping(part, f"see of rule {name}")
    if mapping is None:
        return {}
    if not topics or not mapping.entries:
        mapping.mistake(f"rule {name}: nothing to see", "add a subscribe right, or remove see")
        return {}
    if not any(key.startswith(BEGINS_TOPIC) for key in mapping.entries):
        return dict.fromkeys(topics, _levels(mapping))
    found = source.by_topic(mapping, "see", name, topics, Right.SUBSCRIBE)
    return {topic: _levels(inner) for topic, (_, inner) in found.items()}


def _levels(mapping: YamlMapping) -> TopicLevels:
    levels: dict[DataWord, str] = {}
    for name, (key, value) in mapping.entries.items():
        if name not in list(DataWord):
            key.mistake(f"unknown word {name[:60]!r} in see", suggest(name, list(DataWord)))
        elif name == DataWord.PRESENCE and getattr(value, "value", None) == NO:
            hint = "write minute or hour, or take the topic out of the rule"
            value.mistake("presence: a message that arrives tells it", hint)
        elif level := source.choice(value, f"level of {name}", LEVELS[DataWord(name)]):
            levels[DataWord(name)] = level
    return TopicLevels(mapping, levels)


def resolve_levels(
    layout: Layout, vocabulary: Vocabulary, topic: str, said: TopicLevels, others: Iterable[FilterRule]
) -> Resolved | None:
    # `others` are the rules of a `filter` beside it: they may not be for the same fields.
    coarse = any(level != EXACT for level in said.levels.values())
    for path, other in vocabulary.contradictions(layout, topic).items() if coarse else ():
        message = f"{topic}: the vocabulary says something else of {path} on {other}"
        said.position.mistake(message, "name the topics one by one, or say the same of both")
        return None
    try:
        described = vocabulary.describe(layout, topic)
        found = resolve(layout, described, said.levels, vocabulary.rooms)
        compile_filter(layout, (*found.rules, *others))
    except FilterRefused as error:
        said.position.mistake(f"{topic}: {error}", error.hint.replace("/the/topic", topic))
        return None
    return found


# Conditions of several rules on one topic hold together, so what is valid rule by rule may be too much for
# one grant and cannot be divided. Such a right is refused alone, by its name, before anything is signed.
@lru_cache(maxsize=4096)
def why_unsignable(permissions: tuple[Permission, ...]) -> str:
    """Why no grant can have these entries together, as every verifier would say; empty: it can."""
    try:
        for item in permissions:
            for text in item.restriction.conditions if item.restriction is not None else ():
                check_syntax(text)
        scope = document.scope_of(permissions)
        if len(scope) > MAX_SCOPE:
            return "its conditions and filters are too large for one grant"
        document.read_scope(scope)
    except HintedError as error:
        return str(error)
    except UnicodeEncodeError:
        return "a text in it is not Unicode"
    return ""


def divide(
    rights: Iterable[_Right], entries: Callable[[_Right], Sequence[Permission]]
) -> Iterator[tuple[_Right, ...]]:
    part: list[_Right] = []
    size = number = 0
    for each in rights:
        found = entries(each)
        text = sum(len(repr(item)) for item in found)
        number += len(found)
        size += text
        if part and (number > MAX_ENTRIES or size > _MAX_TEXT):
            yield tuple(part)
            part, size, number = [], text, len(found)
        part.append(each)
    if part:
        yield tuple(part)
