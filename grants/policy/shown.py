"""What a policy lets a node see of a topic, in the words of people. Pure.

For explanations, reports and assertions: from the verdict, whichever rules, filters and presets it
came from. A topic of unknown type says nothing.
"""

from collections.abc import Callable, Sequence

from grants.filters.layout import Layout
from grants.policy.decision import Verdict
from grants.policy.model import Policy
from grants.vocabulary.assess import Seen, assess
from grants.vocabulary.sentences import details, seen
from grants.vocabulary.words import DataWord

LayoutOf = Callable[[str], Layout]


def shown(
    policy: Policy, verdict: Verdict, layout_of: LayoutOf, words: Sequence[DataWord] | None = None
) -> dict[DataWord, Seen]:
    """At which level each word of the topic is seen; empty for what is not allowed or not known.

    `words` are those asked for; without them those the type carries.
    """
    kind = next((item.type for item in verdict.restrictions if item.type), None)
    kind = kind or policy.type_of(verdict.name)
    if not verdict or kind is None:
        return {}
    described = policy.vocabulary.describe(layout_of(kind), verdict.name)
    return assess(described, verdict.restrictions, verdict.rate, words)


def lines(found: dict[DataWord, Seen]) -> list[str]:
    """One line for each word: `sees where it is: the room (no finer than 4 m, ...)`."""
    return [_line(one) for one in found.values()]


def _line(one: Seen) -> str:
    numbers = details(one)
    return f"sees {seen(one)}" + (f" ({numbers})" if numbers else "")


def as_json(found: dict[DataWord, Seen]) -> dict[str, str]:
    """The level by word; a position between two levels is `2 m`."""
    return {word.value: one.size_text or one.level for word, one in found.items()}
