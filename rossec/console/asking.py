"""A node's request for grants in words and pictures. Pure.

The heading is a sentence: what the node wants, of whom. Below it, each way in which a person could
approve it, with what the node would see of the same minute. What a node would do is told apart from
what it would see. The way that shows least is chosen beforehand: more is given only on purpose.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from grants.claims import read_scope
from grants.model import Restriction, Right
from grants.vocabulary.assess import assess
from grants.vocabulary.words import rank
from rossec import clock
from rossec.authority.console.views import AskedRight, FactView, GrantQuestion, QuestionAnswer
from rossec.console import made_up, words
from rossec.console.approving import DAY
from rossec.console.matrix import Access, Cell
from rossec.console.pictures import looks as pictures
from rossec.console.pictures.place import has_place
from rossec.console.samples import Preview
from rossec.console.sentences import Part, wanted
from rossec.ros.text import printable

MAX_PICTURES: Final = 2  # topics
_MOST: Final = 4  # rights in the sentence
ACTS: Final = Right.PUBLISH | Right.CALL | Right.PROVIDE | Right.PARAM_SET | Right.ADMIN
DRIVING: Final = frozenset(
    {"geometry_msgs/Twist", "geometry_msgs/TwistStamped", "ackermann_msgs/AckermannDrive",
     "ackermann_msgs/AckermannDriveStamped"}
)  # fmt: skip
LABELS: Final[Mapping[str, str]] = {
    "": "All of it, as it asks",
    "coarse": "Coarser",
    "coarse-position": "Only roughly where it is",
    "presence-only": "Only that it is there",
    "anonymous-diagnostics": "Only whether its parts are well, without names",
    "blurred-camera": "Only a blurred picture",
}
"""What a filter is called: rossec's own ones. One of the policy has the name that it has there."""


class Way(NamedTuple):
    """A way to approve: through the filter `coarse` (empty: none); one line for each right.

    `exact` is what each line leaves out; `is_narrowest`: no other way shows less.
    """

    coarse: str
    label: str
    lines: tuple[tuple[Part, ...], ...]
    exact: tuple[str, ...]
    is_narrowest: bool


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
    minutes: int = 1


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


def ways(given: Sequence[tuple[str, Sequence[AskedRight]]], most: int = 6) -> list[Way]:
    """What the node would get, in words; the narrowest first, as it asks last.

    Of more than `most` those that show least, and what it asks for.
    """
    narrow = sorted(given, key=lambda each: strictness(each[1]), reverse=True)
    shown = [
        *[each for each in narrow if each[0]][: most - 1],
        *(each for each in given if not each[0]),
    ]
    return [
        Way(
            coarse,
            LABELS.get(coarse, f"Coarser: {printable(coarse, 80)}"),
            tuple(_line(right) for right in rights),
            tuple(filter(None, (words.restrictions(_restrictions(right)) for right in rights))),
            coarse == narrow[0][0],
        )
        for coarse, rights in shown
    ]


def strictness(rights: Iterable[AskedRight]) -> tuple[int, float, int]:
    """How little it shows: levels of the vocabulary, then how seldom, then how many fields less."""
    levels, interval, number = 0, 0.0, 0
    for right in rights:
        found = _restrictions(right)
        kind = next((each.type for each in found if each.type), right.type)
        described = words.description(kind) if kind else None
        if described is not None:
            levels += sum(rank(each.word, each.level) for each in assess(described, found).values())
        for each in found:
            interval += max(each.slot or 0, 1 / each.rate if each.rate else 0)
            number += len(each.filters) + len(each.conditions)
    return levels, interval, number


def acts(rights: Iterable[AskedRight]) -> bool:
    """Whether it would do something, and not only see it."""
    return any(right.right & ACTS for right in rights)


def why_no_coarser(question: GrantQuestion) -> str:
    """Why there is no coarser choice; empty where there is one."""
    right = question.rights[0]
    if question.coarse:
        return ""
    if right.right & ACTS:
        return "This is something that it would do: there is no coarser form of it, only yes or no."
    if right.right != Right.SUBSCRIBE:
        return "Only what is sent can be coarser, and this is something else."
    if "*" in right.pattern:
        return "These are many topics at once, which have no coarser form in common."
    if not right.type:
        return (
            "There is no coarser choice, since the policy does not say of which type these messages"
            " are: add the topic to its types."
        )
    return f"No filter of the policy, and none of rossec's own, fits messages of {right.type}."


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
    given = [  # a button that promises more than the policy would be a lie
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


def answer(given: QuestionAnswer) -> tuple[Part, ...]:
    """`/lamp may not see /robot/camera`."""
    verb = "may" if given.answer == "granted" else "may not"
    return (
        Part(words.name(given.node), is_name=True),
        Part(f"{verb} {wanted(given.right)}"),
        Part(words.topic(given.pattern), is_name=True),
    )


def drives(right: AskedRight) -> bool:
    """Whether it is the right to steer."""
    name = right.pattern.rpartition("/")[2]
    is_driving = right.type in DRIVING or name.endswith("cmd_vel")
    return right.right == Right.PUBLISH and is_driving


def _wish(right: AskedRight, senders: dict[str, set[str]]) -> list[Part]:
    if drives(right):
        return [Part("drive: send commands to"), Part(words.topic(right.pattern), is_name=True)]
    known = sorted(senders.get(right.pattern, ()))
    if right.right == Right.SUBSCRIBE and has_place(right.type) and len(known) == 1:
        return [Part("see where"), Part(words.name(known[0]), is_name=True), Part("is")]
    return [Part(wanted(right.right)), Part(words.topic(right.pattern), is_name=True)]


def _line(right: AskedRight) -> tuple[Part, ...]:
    said = words.plain(_restrictions(right))
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
    applied = [each for _, rights in ways for one in rights for each in _restrictions(one)]
    recorded = recorded or made_up.recorded(right.pattern, right.type, applied)
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
        text = words.plain(restrictions)
        cell = Cell(node, right.pattern, access, text, restrictions=restrictions)
        drawn += [(name, look) for look in pictures.compare(recorded, [cell]).looks]
    return Looks(right.pattern, recorded.is_made_up, tuple(drawn), pictures.minutes(recorded))
