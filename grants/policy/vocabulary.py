"""The vocabulary of a policy: what the fields of its own types tell, and of bare values.

`vocabulary` names types (`acme_msgs/Bed`) and topics (`/door/open`, for a value such as a
std_msgs/Bool, whose meaning only the topic knows). A field tells a word, and is then hidden at
every level but `exact`, or has a content of `grants.vocabulary.contents`, and is then treated as
these are. What the standard table knows cannot be said otherwise.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from grants.errors import FilterRefused
from grants.filters.layout import TYPE_NAME, Layout
from grants.policy import readers
from grants.policy.mistakes import Mistakes, suggest
from grants.policy.own_names import BEGINS_TOPIC, any_node
from grants.policy.patterns import includes, intersects
from grants.policy.source import Part, YamlMapping, YamlScalar
from grants.vocabulary.contents import NOT_KNOWN, Content, Fields
from grants.vocabulary.describe import Description, describe
from grants.vocabulary.levels import Treatment
from grants.vocabulary.rooms import plan_treatment
from grants.vocabulary.words import DataWord

# A word alone: a content of that word that no level shows in part.
_HIDDEN: Final[Mapping[str, Content]] = {
    DataWord.POSITION: Content.UNCERTAINTY,
    DataWord.MOVEMENT: Content.JOINT,
    DataWord.IMAGE: Content.COMPRESSED_PICTURE,
    DataWord.SOUND: Content.SAMPLES,
    DataWord.PRESENCE: Content.TIME,
    DataWord.IDENTITY: Content.MARK,
    DataWord.HOME: Content.READING,
}
# Pixels can only be treated where their size is said, in a sensor_msgs/Image.
_NAMED: Final = {
    content.value: content for content in Content if content not in NOT_KNOWN | {Content.PICTURE}
}
SAYABLE: Final[Mapping[str, Content]] = {**_NAMED, **_HIDDEN}
"""What a policy can say of a field."""


@dataclass(frozen=True)
class Vocabulary:
    """Contents by field, by type and by topic or pattern of topics; and the rooms there are."""

    types: Mapping[str, Fields] = field(default_factory=dict)
    topics: Mapping[str, Fields] = field(default_factory=dict)
    rooms: Treatment | None = None

    def describe(self, layout: Layout, topic: str = "") -> Description:
        """The contents of messages of `layout` on `topic`."""
        here = self._said(topic)
        doubtful = dict.fromkeys(self.contradictions(layout, topic), Content.UNKNOWN)
        return describe(layout, self.types, {**here, **doubtful})

    def contradictions(self, layout: Layout, topic: str) -> dict[str, str]:
        """Fields of which the vocabulary says one thing here and another elsewhere in `topic`.

        Each with the topic or pattern that says so: a narrower one than the pattern `topic`, or one
        that overlaps with another. None can be held for all, so they are unknown.
        """
        here = self._said(topic)
        known = describe(layout, self.types, here)
        found: dict[str, str] = {}
        for pattern, fields in self.topics.items() if topic else ():
            if self._decides(pattern, topic) or not intersects(any_node(pattern), any_node(topic)):
                continue
            for path, content in fields.items():
                below = {one.content for one in known.fields if _is_below(one.path, path)}
                if below - {content}:
                    found[path] = pattern
        return found

    def _said(self, topic: str) -> dict[str, Content]:
        """What is said of the fields on `topic`; the narrowest pattern that covers it decides."""
        covering = [pattern for pattern in self.topics if topic and self._covers(pattern, topic)]
        here: dict[str, Content] = {}
        for pattern in sorted(
            covering, key=lambda one: self._narrower(one, covering), reverse=True
        ):
            here.update(self.topics[pattern])
        return here

    def _covers(self, pattern: str, topic: str) -> bool:
        return includes(any_node(pattern), any_node(topic))

    def _narrower(self, pattern: str, others: Iterable[str]) -> int:
        """How many of the others lie in `pattern`."""
        return sum(self._covers(pattern, other) for other in others)

    def _decides(self, pattern: str, topic: str) -> bool:
        """Whether `pattern` covers `topic`, and what it says is said again or not contradicted.

        So it is if `topic` itself is in the vocabulary, or all that cover it are nested.
        """
        covering = [each for each in self.topics if self._covers(each, topic)]
        return pattern in covering and (
            topic in covering
            or all(self._covers(pattern, one) or self._covers(one, pattern) for one in covering)
        )


LayoutOfType = Callable[[str, YamlScalar], Layout | None]
"""The layout of a type; None if it is unknown, which is then recorded as a mistake."""


def read_rooms(part: Part | None, mistakes: Mistakes) -> Treatment | None:
    """Read `{NAME: CORNERS}`, a plan in metres in the frame of the positions."""
    mapping = readers.mapping(part, "rooms", mistakes)
    if mapping is None:
        return None
    plan = {
        name: readers.text(value, name, mistakes) for name, (_, value) in mapping.entries.items()
    }
    if None in plan.values():
        return None
    try:
        return plan_treatment({name: text for name, text in plan.items() if text is not None})
    except FilterRefused as error:
        mistakes.add(mapping, str(error).removeprefix("position: "), error.hint)
        return None


def read_vocabulary(
    part: Part | None,
    rooms: Part | None,
    types: Mapping[str, str],
    layout_of: LayoutOfType,
    mistakes: Mistakes,
) -> Vocabulary:
    """Read `{TYPE or TOPIC: {FIELD: WORD or CONTENT}}` and `rooms`; `types` are those of topics."""
    mapping = readers.mapping(part, "vocabulary", mistakes)
    found: dict[bool, dict[str, Fields]] = {True: {}, False: {}}

    def read_key(key: YamlScalar) -> str | None:
        is_topic = str(key.value).startswith(BEGINS_TOPIC)
        return readers.pattern(key, "topic", mistakes) if is_topic else str(key.value)

    for name, key, value in readers.by_name(mapping, "vocabulary", read_key, mistakes):
        is_topic = name.startswith(BEGINS_TOPIC)
        type_name = _type_of_topic(name, key, types, mistakes) if is_topic else name
        fields = readers.mapping(value, f"vocabulary of {name}", mistakes)
        if type_name is None or fields is None or not _is_type(type_name, key, mistakes):
            continue
        layout = layout_of(type_name, key)
        if layout is not None:
            found[is_topic][name] = _fields(layout, fields, mistakes)
    return Vocabulary(found[False], found[True], read_rooms(rooms, mistakes))


def _is_below(leaf: str, path: str) -> bool:
    """Whether a field is the one at `path`, or in it."""
    return f"{leaf}.".replace("[*]", "").startswith(f"{path}.")


def _type_of_topic(
    name: str, key: YamlScalar, types: Mapping[str, str], mistakes: Mistakes
) -> str | None:
    if name not in types:
        hint = suggest(name, types) or f"add it to types: {{{name}: package/Type}}"
        mistakes.add(key, f"the message type of {name[:80]} is unknown", hint)
    return types.get(name)


def _is_type(name: str, key: YamlScalar, mistakes: Mistakes) -> bool:
    if TYPE_NAME.fullmatch(name) is None:
        mistakes.add(key, f"not a type or a topic: {name[:80]!r}", "package/Type, or /topic")
        return False
    return True


def _fields(layout: Layout, mapping: YamlMapping, mistakes: Mistakes) -> Fields:
    known = describe(layout)
    fields: dict[str, Content] = {}
    for path, key, value in readers.by_name(
        mapping, known.type_name, lambda key: str(key.value).replace("[*]", ""), mistakes
    ):
        said = readers.choice(value, "word or content", SAYABLE, mistakes)
        if said is not None and _may_be_said(known, path, key, mistakes):
            fields[path] = SAYABLE[said]
    return fields


def _may_be_said(known: Description, path: str, key: YamlScalar, mistakes: Mistakes) -> bool:
    below = [one for one in known.fields if _is_below(one.path, path)]
    if not below:
        hint = suggest(path, [one.path for one in known.fields])
        mistakes.add(key, f"no field {path[:80]!r} in {known.type_name}", hint)
        return False
    if any(one.content not in NOT_KNOWN for one in below):
        message = f"{path} of {known.type_name} is in the standard vocabulary"
        mistakes.add(key, message, f"it is: {below[0].content}; remove this line")
        return False
    return True
