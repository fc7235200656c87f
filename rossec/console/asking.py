"""A node's request for grants in words and pictures. Pure.

The heading is a sentence: what the node wants, of whom. Below it, each way in which a person could
approve it, with what the node would see of the same minute.
"""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from grants.claims import read_scope
from grants.model import Restriction, Right
from rossec import clock
from rossec.authority.console.views import AskedRight, FactView, GrantQuestion
from rossec.console import made_up, words
from rossec.console.approving import DAY
from rossec.console.matrix import Access, Cell
from rossec.console.pictures import looks as pictures
from rossec.console.pictures.place import has_place
from rossec.console.samples import Preview
from rossec.console.sentences import Part, wanted

MAX_PICTURES: Final = 2  # topics
_MOST: Final = 4  # rights in the sentence


class Way(NamedTuple):
    """A way to approve: through the filter `coarse` (empty: none); one line for each right."""

    coarse: str
    lines: tuple[tuple[Part, ...], ...]


class Duration(NamedTuple):
    """A button: value and label, what it means, and whether the policy allows so long."""

    value: str
    label: str
    detail: str
    is_possible: bool


class Looks(NamedTuple):
    """The pictures of one topic, by the filter through which the node would see it."""

    topic: str
    is_made_up: bool
    pictures: tuple[tuple[str, pictures.Look], ...]


def sentence(question: GrantQuestion, facts: Iterable[FactView]) -> tuple[Part, ...]:
    """`/heating wants to see where /robot is`."""
    senders: dict[str, set[str]] = {}
    for fact in facts:
        if fact.kind == "publisher":
            senders.setdefault(fact.name, set()).add(fact.node)
    parts = [Part(words.name(question.node), is_name=True), Part("wants to")]
    shown = question.rights[:_MOST]
    for place, right in enumerate(shown):
        parts += [*([Part("and to")] if place else []), *_wish(right, senders)]
    if len(question.rights) > len(shown):
        parts.append(Part(f"and {len(question.rights) - len(shown)} more things"))
    return tuple(parts)


def way(coarse: str, rights: Iterable[AskedRight]) -> Way:
    """What the node would get, in words."""
    return Way(coarse, tuple(_line(right) for right in rights))


def looks(
    node: str,
    ways: Sequence[tuple[str, Sequence[AskedRight]]],
    preview: Preview | None = None,
) -> list[Looks]:
    """What the node would see, of topics whose messages can be drawn.

    Of real messages where `preview` has some, else of made-up ones.
    """
    found = []
    for right in ways[0][1]:
        if right.right == Right.SUBSCRIBE and right.type and "*" not in right.pattern:
            drawn = _looks(node, right, ways, preview)
            found += [drawn] if drawn is not None else []
    return found[:MAX_PICTURES]


def durations(question: GrantQuestion, now: int) -> list[Duration]:
    """The four buttons; none promises more than the policy gives."""
    most = question.lifetime
    allowed = words.duration(most)
    today = clock.seconds_left_today(now)
    given = [
        Duration("today", "Today", f"{words.duration(min(today, most))}", True),
        Duration("week", "For a week", "", most >= 7 * DAY),
        Duration("month", "For a month", "", most >= 30 * DAY),
    ]
    return [
        *(
            each if each.is_possible else each._replace(detail=f"the policy allows {allowed}")
            for each in given
        ),
        Duration("open", "Until I end it", f"at most {allowed}, says the policy", True),
    ]


def _wish(right: AskedRight, senders: dict[str, set[str]]) -> list[Part]:
    known = sorted(senders.get(right.pattern, ()))
    if right.right == Right.SUBSCRIBE and has_place(right.type) and len(known) == 1:
        return [Part("see where"), Part(words.name(known[0]), is_name=True), Part("is")]
    return [Part(wanted(right.right)), Part(words.topic(right.pattern), is_name=True)]


def _line(right: AskedRight) -> tuple[Part, ...]:
    said = words.restrictions(_restrictions(right))
    return (
        Part(wanted(right.right)),
        Part(words.topic(right.pattern), is_name=True),
        Part(f"({said})" if said else "(all of it)"),
    )


def _restrictions(right: AskedRight) -> tuple[Restriction, ...]:
    permissions = read_scope(right.permissions)
    return tuple(each.restriction for each in permissions if each.restriction is not None)


def _looks(
    node: str,
    right: AskedRight,
    ways: Sequence[tuple[str, Sequence[AskedRight]]],
    preview: Preview | None,
) -> Looks | None:
    recorded = None if preview is None else preview.recorded(right.pattern)
    recorded = recorded or made_up.recorded(right.pattern, right.type)
    if recorded is None:
        return None
    drawn: list[tuple[str, pictures.Look]] = []
    ways_seen: set[tuple[Restriction, ...]] = set()
    for name, rights in ways:
        same = [each for each in rights if (each.right, each.pattern) == right[:2]]
        restrictions = tuple(each for one in same for each in _restrictions(one))
        if restrictions in ways_seen:  # two filters that do the same here
            continue
        ways_seen.add(restrictions)
        access = Access.COARSE if restrictions else Access.ALL
        text = words.restrictions(restrictions)
        cell = Cell(node, right.pattern, access, text, restrictions=restrictions)
        drawn += [(name, look) for look in pictures.compare(recorded, [cell]).looks]
    return Looks(right.pattern, recorded.is_made_up, tuple(drawn))
