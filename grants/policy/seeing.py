"""`see` in a rule: levels of words, for all topics of the rule or by topic, as a filter of each.

`see: {position: room, image: no}`, or `see: {/robot/pose: {position: room}}`. What is said is an
upper limit; a word that is not mentioned is shown as it is, unless it gives away one that is.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from grants.errors import FilterRefused
from grants.filters.compile import compile_filter
from grants.filters.layout import Layout
from grants.model import FilterRule
from grants.policy import readers
from grants.policy.mistakes import Mistakes, SourcePosition, suggest
from grants.policy.own_names import BEGINS_TOPIC
from grants.policy.source import Part, YamlMapping
from grants.policy.vocabulary import Vocabulary
from grants.vocabulary.resolve import Levels, Resolved, resolve
from grants.vocabulary.words import EXACT, LEVELS, NO, DataWord


@dataclass(frozen=True)
class TopicLevels:
    """The levels of one topic."""

    position: SourcePosition
    levels: Levels = field(default_factory=dict)


def read_see(
    part: Part | None, topics: Sequence[str], name: str, mistakes: Mistakes
) -> dict[str, TopicLevels]:
    """The levels of every topic that `see` of the rule `name` says some of."""
    mapping = readers.mapping(part, f"see of rule {name}", mistakes)
    if mapping is None:
        return {}
    if not topics or not mapping.entries:
        hint = "add a subscribe right, or remove see"
        mistakes.add(mapping, f"rule {name}: nothing to see", hint)
        return {}
    if not any(key.startswith(BEGINS_TOPIC) for key in mapping.entries):
        return dict.fromkeys(topics, _levels(mapping, mistakes))
    found: dict[str, TopicLevels] = {}
    what = f"see of rule {name}"
    for topic, key, value in readers.by_name(
        mapping, what, lambda key: readers.pattern(key, what, mistakes), mistakes
    ):
        inner = readers.mapping(value, f"see of {topic}", mistakes)
        if topic not in topics:
            message = f"rule {name} has no subscribe right on {topic[:80]!r}"
            mistakes.add(key, message, suggest(topic, topics))
        elif inner is not None:
            found[topic] = _levels(inner, mistakes)
    return found


def _levels(mapping: YamlMapping, mistakes: Mistakes) -> TopicLevels:
    levels: dict[DataWord, str] = {}
    for name, (key, value) in mapping.entries.items():
        if name not in list(DataWord):
            mistakes.add(key, f"unknown word {name[:60]!r} in see", suggest(name, list(DataWord)))
            continue
        word = DataWord(name)
        if word is DataWord.PRESENCE and getattr(value, "value", None) == NO:
            hint = "write minute or hour, or take the topic out of the rule"
            mistakes.add(value, "presence: a message that arrives tells it", hint)
            continue
        level = readers.choice(value, f"level of {word}", LEVELS[word], mistakes)
        if level is not None:
            levels[word] = level
    return TopicLevels(mapping, levels)


def resolve_levels(
    layout: Layout,
    vocabulary: Vocabulary,
    topic: str,
    said: TopicLevels,
    others: Iterable[FilterRule],
    mistakes: Mistakes,
) -> Resolved | None:
    """The filter for messages of `layout` on `topic`; None if a level cannot be held.

    `others` are the rules of a `filter` beside it: they may not be for the same fields.
    """
    coarse = any(level != EXACT for level in said.levels.values())
    for path, other in vocabulary.contradictions(layout, topic).items() if coarse else ():
        message = f"{topic}: the vocabulary says something else of {path} on {other}"
        mistakes.add(said.position, message, "name the topics one by one, or say the same of both")
        return None
    try:
        described = vocabulary.describe(layout, topic)
        found = resolve(layout, described, said.levels, vocabulary.rooms)
        compile_filter(layout, (*found.rules, *others))
    except FilterRefused as error:
        mistakes.add(said.position, f"{topic}: {error}", error.hint.replace("/the/topic", topic))
        return None
    return found
