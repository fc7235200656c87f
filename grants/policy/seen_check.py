"""Whether a field, or a word of the vocabulary, is seen as a test of a policy says. Pure.

A field is judged by what its filters let through (`sight`), of a word all fields count that tell it
(`grants.vocabulary.assess`). A name that is both, such as `position`, is the word where the type
tells it; a part of the field is written `position.x`.
"""

from collections.abc import Callable
from typing import Final

from grants.errors import PolicyRefused
from grants.filters.layout import Layout, Primitive, Text
from grants.policy.assertions import EXACT, NOTHING, SeenField
from grants.policy.decision import Verdict
from grants.policy.mistakes import suggest
from grants.policy.model import Policy
from grants.policy.sample_messages import below, leaves
from grants.policy.sight import Sight
from grants.vocabulary.assess import assess
from grants.vocabulary.contents import FRAMES
from grants.vocabulary.describe import Description
from grants.vocabulary.words import LEVELS, DataWord

_WORDS: Final = frozenset(word.value for word in DataWord)


def seen_too_well(
    policy: Policy, layout_of: Callable[[str], Layout], verdict: Verdict, seen: SeenField
) -> str:
    """The first field, or the word, that is seen otherwise than `seen` says; empty if none is.

    Raises:
        GrantError: it cannot be told: no such type, field or level, or filters that refuse what is
            tried.
    """
    kind = policy.type_of(seen.topic)
    if kind is None:
        hint = f"add it to types: {{{seen.topic}: package/Type}}"
        raise PolicyRefused(f"the message type of {seen.topic} is unknown", hint)
    layout = layout_of(kind)
    description = policy.vocabulary.describe(layout, seen.topic)
    if seen.path in _WORDS and description.tells(DataWord(seen.path)):
        return _word(description, verdict, seen)
    fields = leaves(layout)
    paths = below(fields, seen.path)
    if not paths:
        raise PolicyRefused(f"no field {seen.path!r} in {kind}")
    frames = {each.path for each in description.fields if each.content in FRAMES}
    sight = Sight(layout, verdict, frames)
    return next((path for path in paths if not _holds(sight, path, fields[path], seen)), "")


def _holds(sight: Sight, path: str, kind: Primitive | Text, seen: SeenField) -> bool:
    if seen.limit == EXACT:
        return sight.is_exact(path)
    if seen.limit == NOTHING:
        return sight.is_hidden(path)
    if isinstance(seen.limit, str):
        hint = f"write a number (no finer than that), {NOTHING} or {EXACT}"
        raise PolicyRefused(f"not how a field is seen: {seen.limit[:40]!r}", hint)
    if not isinstance(kind, Primitive) or kind.name == "bool":
        raise PolicyRefused(f"{path} is no number", f"write {NOTHING} or {EXACT}")
    return sight.is_no_finer_than(path, seen.limit)


def _word(description: Description, verdict: Verdict, seen: SeenField) -> str:
    """The word, if more of it is seen than the test says; else empty."""
    word = DataWord(seen.path)
    if isinstance(seen.limit, str) and seen.limit not in LEVELS[word]:
        hint = suggest(seen.limit, LEVELS[word])
        raise PolicyRefused(f"not a level of {word}: {seen.limit[:40]!r}", hint)
    if isinstance(seen.limit, float) and word is not DataWord.POSITION:
        hint = f"write one of {', '.join(LEVELS[word])}"
        raise PolicyRefused(f"{word} has no length", hint)
    found = assess(description, verdict.restrictions, verdict.rate, [word])[word]
    if seen.limit == EXACT:
        return "" if found.level == EXACT and not found.size else word
    if found.is_no_finer_than(seen.limit):
        return ""
    by = f", by {', '.join(found.open)}," if found.open else ""
    return f"{word} ({found.level}{by})".replace(",)", ")")
