"""What happened, in sentences: entries of the record's log and denials, merged, newest first. Pure.

A sentence has parts, so that a page can set names apart from its own words.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias

from grants.model import Grant, Permission, Right
from rossec.authority.console.messages import DenialView, EventView, GrantQuestion, NodeView
from rossec.console import words
from rossec.console.matrix import ShownGrant
from rossec.peer_limits import printable


class SentencePart(NamedTuple):
    text: str
    is_name: bool = False  # one of ROS, shown as such

    @property
    def is_glued(self) -> bool:
        return not self.is_name and self.text[:1] in (",", ":")

    @property
    def spaced(self) -> str:
        return self.text if self.is_glued else f" {self.text}"


Sayable: TypeAlias = tuple[SentencePart, ...]


def say(*pieces: SentencePart | str) -> Sayable:
    """A sentence of names and plain words."""
    return tuple(SentencePart(each) if isinstance(each, str) else each for each in pieces)


def name_part(text: object) -> SentencePart:
    return SentencePart(words.name(text), is_name=True)


def topic_part(pattern: str) -> SentencePart:
    return SentencePart(words.topic(pattern), is_name=True)


class Sentence(NamedTuple):
    at: int
    tone: str  # `joined`, `allowed`, `ended`, `refused`, `asked`, `note`
    verb: str
    parts: tuple[SentencePart, ...]
    number: int  # of the log entry; -1: a denial
    node: str  # whom it is about, if it is one

    @property
    def text(self) -> str:
        return self.verb + "".join(part.spaced for part in self.parts)


class KnownIds(NamedTuple):
    """What the ids in log entries mean, all in hex."""

    grants: Mapping[str, Grant]
    nodes: Mapping[str, str]  # by key
    questions: Mapping[str, tuple[GrantQuestion, ...]]
    ending: frozenset[str] = frozenset()  # what was ended and may still be used

    @classmethod
    def of(
        cls,
        held: Iterable[ShownGrant] = (),
        nodes: Iterable[NodeView] = (),
        questions: Iterable[GrantQuestion] = (),
        ending: frozenset[str] = frozenset(),
    ) -> "KnownIds":
        asked: dict[str, tuple[GrantQuestion, ...]] = {}
        for each in questions:
            number = each.request.hex()
            asked[number] = (*asked.get(number, ()), each)
        return cls(
            {each.view.id.hex(): each.grant for each in held},
            {node.key.hex(): node.name for node in nodes},
            asked,
            ending,
        )


_Told: TypeAlias = tuple[str, str, Sayable] | None
_Tell: TypeAlias = Callable[[EventView, KnownIds], _Told]
_TELL: Final[dict[str, _Tell]] = {}  # by the kind of the entry


def _tells(kind: str) -> Callable[[_Tell], _Tell]:
    def add(tell: _Tell) -> _Tell:
        _TELL[kind] = tell
        return tell

    return add


def story(events: Sequence[EventView], denials: Iterable[DenialView], known: KnownIds) -> list[Sentence]:
    """Everything that has a sentence, newest first; equal denials are one with a number."""
    certified = {each.subject: each.number for each in sorted(events) if each.what == "certificate"}
    found = refusals(denials)
    for event in events:
        # What only repeats another entry has no sentence: a request that was answered, the same thing twice.
        answered = certified.get(event.subject, -1) > event.number
        if event.what in _FOLDED or (event.what in ("pending", "approved") and answered):
            continue
        if event.what in _TELL:
            told = _TELL[event.what](event, known)
        else:  # told by its own words, never left out
            shown = known.nodes.get(event.subject, event.subject)
            detail = say(printable(event.detail, 200)) if event.detail else ()
            told = "note", printable(event.what, 40).capitalize(), (name_part(shown), *detail)
        if told is None:
            continue
        node, grant = known.nodes.get(event.subject, ""), known.grants.get(event.subject)
        node = node if grant is None else grant.subject
        node = event.subject if event.subject.startswith("/") else node
        found.append(Sentence(event.at, *told, event.number, node))
    return sorted(found, key=lambda each: (-each.at, -each.number))


def refusals(denials: Iterable[DenialView]) -> list[Sentence]:
    """A sentence for each node, right and name that was denied, at its latest time."""
    groups: dict[tuple[str, int, str], list[int]] = {}
    for denial in denials:
        groups.setdefault((denial.node, denial.right, denial.name), []).append(denial.at)
    found = []
    for (node, right, name), times in groups.items():
        often = f", {len(times)} times" if len(times) > 1 else ""
        end = f"without being allowed to{often}"
        parts = say(name_part(node), f"asked to {wanted(right)}", name_part(name), end)
        found.append(Sentence(max(times), "refused", "Refused", parts, -1, node))
    return found


def wanted(right: int) -> str:
    return words.rights(Right(right)) if 0 < right < 256 else f"do something ({right}) with"


def permission(given: Permission) -> Sayable:
    """`see /robot/pose (coarse)`."""
    return say(words.rights(given.rights), topic_part(given.pattern), *["(coarse)"] * given.is_narrowed)


def permissions(given: Iterable[Permission], limit: int = 4) -> Sayable:
    """As `permission` for all, in the order of the grant; those with the same rights together."""
    groups: dict[tuple[Right, bool], list[Permission]] = {}
    for each in given:
        groups.setdefault((each.rights, each.is_narrowed), []).append(each)
    parts: list[SentencePart | str] = []
    for (rights, coarse), members in groups.items():
        parts += [*(["and"] if parts else []), words.rights(rights)]
        for number, each in enumerate(members[:limit]):
            parts += [*([","] if number else []), topic_part(each.pattern)]
        parts += [f"and {len(members) - limit} more"] if len(members) > limit else []
        parts += ["(coarse)"] * coarse
    return say(*parts)


def _because(reason: str) -> Sayable:
    return say(f": {printable(reason, 200)}") if reason else ()


@_tells("grant")
def _grant(event: EventView, known: KnownIds) -> _Told:
    grant = known.grants.get(event.detail)
    if grant is None:
        return "allowed", "Allowed", say(name_part(event.subject), "got a right that has ended")
    return "allowed", "Allowed", say(name_part(event.subject), "may", *permissions(grant.permissions))


@_tells("revocation")
def _revocation(event: EventView, known: KnownIds) -> _Told:
    grant, node = known.grants.get(event.subject), known.nodes.get(event.subject)
    why = _because(event.detail)
    if event.subject in known.ending and (grant is not None or node is not None):
        still = say(name_part(node or ""), "may still do what it was allowed")
        if grant is not None:
            still = say(name_part(grant.subject), "may still", *permissions(grant.permissions))
        return "ended", "Ending", say(*still, ", until every node has heard", *why)
    if grant is not None:
        gone = say(name_part(grant.subject), "may no longer", *permissions(grant.permissions))
        return "ended", "Ended", (*gone, *why)
    if node is not None:
        return "ended", "Removed", say(name_part(node), "does not belong here any more", *why)
    return "ended", "Ended", say(f"what has the number {event.subject[:8]}", *why)


@_tells("grant request")
def _grant_request(event: EventView, known: KnownIds) -> _Told:
    found = known.questions.get(event.detail)
    if found is None:
        return "asked", "Asked", say(name_part(event.subject), "asked for a right; it is answered")
    rights = [Permission(each.pattern, Right(each.right)) for asked in found for each in asked.rights]
    return "asked", "Asked", say(name_part(event.subject), "asked to", *permissions(rights))


@_tells("decision")
def _decision(event: EventView, _known: KnownIds) -> _Told:
    answer, _, pattern = event.detail.rpartition(" ")
    if answer == "granted":
        return None  # the grant has an entry of its own
    said = "was denied what it asked for:" if answer == "denied" else f"asked, {answer}:"
    return "refused", "Denied", say(name_part(event.subject), said, name_part(pattern))


@_tells("collected")
def _collected(event: EventView, _: KnownIds) -> _Told:
    if event.detail not in ("pending", "approved"):
        return None
    return "note", "Expired", say(name_part(event.subject), "asked to join and got no answer")


def _about(tone: str, verb: str, text: str, *, why: bool = True) -> _Tell:
    def tell(event: EventView, _: KnownIds) -> _Told:
        return tone, verb, say(name_part(event.subject), text, *_because(event.detail if why else ""))

    return tell


def _plain(tone: str, verb: str, before: str) -> _Tell:
    return lambda event, _: (tone, verb, say(before, name_part(event.subject)))


@_tells("pending")
def _pending(event: EventView, _: KnownIds) -> _Told:
    source = say(f"from {printable(event.detail, 80)}") if event.detail else ()
    return "asked", "Asked", say(name_part(event.subject), "asked to join", *source)


@_tells("restored")
def _restored(event: EventView, _: KnownIds) -> _Told:
    return "note", "Restored", say(f"the record was put back {printable(event.detail, 80)}")


@_tells("domain")
def _domain(event: EventView, _: KnownIds) -> _Told:
    called = f"is trusted as far as was said, and called {printable(event.detail, 40)}"
    return "allowed", "Domain", say(printable(event.subject, 80), called)


@_tells("approval")
def _approval(event: EventView, _: KnownIds) -> _Told:
    what = printable(event.detail.split(" ")[0], 40)
    return "allowed", "Approved", say(APPROVED.get(what, what), "with", printable(event.subject, 80))


@_tells("approval ended")
def _approval_ended(event: EventView, _: KnownIds) -> _Told:
    if event.detail.startswith("done"):
        return None  # what it made has entries of its own
    return "note", "Approval", say(printable(event.detail, 200))


APPROVED: Final[Mapping[str, str]] = {
    "enroll": "that a node joins",
    "grant": "a right",
    "policy": "what the policy changes",
    "delegate": "that the master renews",
    "intermediate": "that an intermediate authority signs",
    "passkey": "another phone",
    "invitation": "a join code",
    "foreign_domain": "another domain",
    "revoke_master": "that the master is removed",
}
_FOLDED: Final = frozenset({"issued", "policy grant"})
_TELL.update(
    {
        "approved": _about("allowed", "Approved", "may join"),
        "denied": _about("refused", "Denied", "may not join"),
        "certificate": _about("joined", "Joined", "belongs here now", why=False),
        "list": _plain("note", "Signed", "the list of ended rights, number"),
        "invitation": _plain("allowed", "Join code", "made for"),
        "join": _about("note", "Code used", "came with a join code", why=False),
        "invitation ended": _about("ended", "Ended", "can no longer be joined with its code"),
        "imported": _plain("note", "Imported", "from an intermediate:"),
        "passkey": lambda event, _: ("joined", "Phone", say(printable(event.subject, 80), "can approve now")),
        "passkey ended": _about("ended", "Removed", "can no longer approve"),
        "domain ended": _about("ended", "Domain", "is not trusted any more"),
        "domain list": _plain("note", "Signed", "the list of other domains, number"),
        "thing": _plain("allowed", "Thing", "known with its border router:"),
        "foreign certificate": _plain("note", "Known", "a node of another domain:"),
    }
)
KINDS: Final = _TELL.keys() | _FOLDED
"""The kinds of log entries that are told in words of their own, or by another one."""
