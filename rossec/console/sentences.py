"""What happened, in sentences: entries of the record's log and denials, merged, newest first. Pure.

A sentence has parts, so that a page can set names apart from its own words. Entries that only
repeat another one (`issued` beside `certificate`) have no sentence; an entry of a kind that is not
in the table is told by its own words, never left out.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias

from grants.model import Grant, Permission, Right
from rossec.authority.console.messages import DenialView, EventView, GrantQuestion, NodeView
from rossec.console import words
from rossec.console.matrix import ShownGrant
from rossec.peer_limits import printable


class SentencePart(NamedTuple):
    """A piece of a sentence; a name is one of ROS, shown as such."""

    text: str
    is_name: bool = False

    @property
    def is_glued(self) -> bool:
        return not self.is_name and self.text[:1] in (",", ":")

    @property
    def spaced(self) -> str:
        return self.text if self.is_glued else f" {self.text}"


class Sentence(NamedTuple):
    """One thing that happened; `tone` is `joined`, `allowed`, `ended`, `refused`, `asked`, `note`.

    `number` is that of the log entry, -1 of a denial; `node` is whom it is about, if it is one.
    """

    at: int
    tone: str
    verb: str
    parts: tuple[SentencePart, ...]
    number: int
    node: str

    @property
    def text(self) -> str:
        return self.verb + "".join(part.spaced for part in self.parts)


class KnownIds(NamedTuple):
    """What the ids in log entries mean: grants by id, nodes by key, questions by id, all in hex.

    `ending`: ids of what was ended and may still be used.
    """

    grants: Mapping[str, Grant]
    nodes: Mapping[str, str]
    questions: Mapping[str, tuple[GrantQuestion, ...]]
    ending: frozenset[str] = frozenset()

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


_Told: TypeAlias = tuple[str, str, tuple[SentencePart, ...]] | None
_Tell: TypeAlias = Callable[[EventView, KnownIds], _Told]


def story(events: Sequence[EventView], denials: Iterable[DenialView], known: KnownIds) -> list[Sentence]:
    """Everything that has a sentence, newest first; equal denials are one with a number."""
    certified = {each.subject: each.number for each in sorted(events) if each.what == "certificate"}

    def repeats(event: EventView) -> bool:
        answered = certified.get(event.subject, -1) > event.number
        return event.what in _FOLDED or (event.what in ("pending", "approved") and answered)

    told = [_event(each, known) for each in events if not repeats(each)]
    found = [each for each in told if each is not None]
    return sorted([*found, *refusals(denials)], key=lambda each: (-each.at, -each.number))


def refusals(denials: Iterable[DenialView]) -> list[Sentence]:
    """A sentence for each node, right and name that was denied, at its latest time."""
    groups: dict[tuple[str, int, str], list[int]] = {}
    for denial in denials:
        groups.setdefault((denial.node, denial.right, denial.name), []).append(denial.at)
    found = []
    for (node, right, name), times in groups.items():
        often = f", {len(times)} times" if len(times) > 1 else ""
        asked, end = (
            SentencePart(f"asked to {wanted(right)}"),
            SentencePart(f"without being allowed to{often}"),
        )
        parts = (_name(node), asked, _name(name), end)
        found.append(Sentence(max(times), "refused", "Refused", parts, -1, node))
    return found


def wanted(right: int) -> str:
    """The right with this number in words; an unknown number is said as it is."""
    return words.rights(Right(right)) if 0 < right < 256 else f"do something ({right}) with"


def permission(given: Permission) -> tuple[SentencePart, ...]:
    """`see /robot/pose (coarse)`."""
    return (
        SentencePart(words.rights(given.rights)),
        SentencePart(words.topic(given.pattern), is_name=True),
        *([SentencePart("(coarse)")] if given.is_narrowed else []),
    )


def permissions(given: Iterable[Permission], limit: int = 4) -> tuple[SentencePart, ...]:
    """As `permission` for all, in the order of the grant; those with the same rights together."""
    groups: dict[tuple[Right, bool], list[Permission]] = {}
    for each in given:
        groups.setdefault((each.rights, each.is_narrowed), []).append(each)
    parts: list[SentencePart] = []
    for (rights, coarse), members in groups.items():
        parts += [*([SentencePart("and")] if parts else []), SentencePart(words.rights(rights))]
        parts += _listed([words.topic(each.pattern) for each in members], limit)
        parts += [SentencePart("(coarse)")] * coarse
    return tuple(parts)


def _listed(names: list[str], limit: int) -> list[SentencePart]:
    parts: list[SentencePart] = []
    for name in names[:limit]:
        parts += [*([SentencePart(",")] if parts else []), SentencePart(name, is_name=True)]
    return [*parts, SentencePart(f"and {len(names) - limit} more")] if len(names) > limit else parts


def _name(text: str) -> SentencePart:
    return SentencePart(words.name(text), is_name=True)


def _because(reason: str) -> tuple[SentencePart, ...]:
    return (SentencePart(f": {printable(reason, 200)}"),) if reason else ()


def _event(event: EventView, known: KnownIds) -> Sentence | None:
    told = _TELL.get(event.what, _unknown)(event, known)
    if told is None:
        return None
    tone, verb, parts = told
    node, grant = known.nodes.get(event.subject, ""), known.grants.get(event.subject)
    node = node if grant is None else grant.subject
    node = event.subject if event.subject.startswith("/") else node
    return Sentence(event.at, tone, verb, parts, event.number, node)


def _unknown(event: EventView, known: KnownIds) -> _Told:
    shown = known.nodes.get(event.subject, event.subject)
    detail = (SentencePart(printable(event.detail, 200)),) if event.detail else ()
    return "note", printable(event.what, 40).capitalize(), (_name(shown), *detail)


def _grant(event: EventView, known: KnownIds) -> _Told:
    grant = known.grants.get(event.detail)
    if grant is None:
        return "allowed", "Allowed", (_name(event.subject), SentencePart("got a right that has ended"))
    parts = (_name(event.subject), SentencePart("may"), *permissions(grant.permissions))
    return "allowed", "Allowed", parts


def _revocation(event: EventView, known: KnownIds) -> _Told:
    grant, node = known.grants.get(event.subject), known.nodes.get(event.subject)
    why = _because(event.detail)
    if event.subject in known.ending and (grant is not None or node is not None):
        still: tuple[SentencePart, ...] = (
            _name(node or ""),
            SentencePart("may still do what it was allowed"),
        )
        if grant is not None:
            still = (_name(grant.subject), SentencePart("may still"), *permissions(grant.permissions))
        return "ended", "Ending", (*still, SentencePart(", until every node has heard"), *why)
    if grant is not None:
        gone = (_name(grant.subject), SentencePart("may no longer"), *permissions(grant.permissions))
        return "ended", "Ended", (*gone, *why)
    if node is not None:
        return "ended", "Removed", (_name(node), SentencePart("does not belong here any more"), *why)
    return "ended", "Ended", (SentencePart(f"what has the number {event.subject[:8]}"), *why)


def _grant_request(event: EventView, known: KnownIds) -> _Told:
    found = known.questions.get(event.detail)
    if found is None:
        return "asked", "Asked", (_name(event.subject), SentencePart("asked for a right; it is answered"))
    rights = [Permission(each.pattern, Right(each.right)) for asked in found for each in asked.rights]
    return "asked", "Asked", (_name(event.subject), SentencePart("asked to"), *permissions(rights))


def _decision(event: EventView, _known: KnownIds) -> _Told:
    answer, _, pattern = event.detail.rpartition(" ")
    if answer == "granted":
        return None  # the grant has an entry of its own
    said = "was denied what it asked for:" if answer == "denied" else f"asked, {answer}:"
    return "refused", "Denied", (_name(event.subject), SentencePart(said), _name(pattern))


def _collected(event: EventView, _: KnownIds) -> _Told:
    if event.detail not in ("pending", "approved"):
        return None
    return "note", "Expired", (_name(event.subject), SentencePart("asked to join and got no answer"))


def _about(tone: str, verb: str, text: str, *, why: bool = True) -> _Tell:
    def tell(event: EventView, _: KnownIds) -> _Told:
        return (
            tone,
            verb,
            (_name(event.subject), SentencePart(text), *(_because(event.detail) if why else ())),
        )

    return tell


def _plain(tone: str, verb: str, before: str) -> _Tell:
    def tell(event: EventView, _: KnownIds) -> _Told:
        return tone, verb, (SentencePart(before), _name(event.subject))

    return tell


def _pending(event: EventView, _: KnownIds) -> _Told:
    source = (SentencePart(f"from {printable(event.detail, 80)}"),) if event.detail else ()
    return "asked", "Asked", (_name(event.subject), SentencePart("asked to join"), *source)


def _restored(event: EventView, _: KnownIds) -> _Told:
    return "note", "Restored", (SentencePart(f"the record was put back {printable(event.detail, 80)}"),)


def _passkey(event: EventView, _: KnownIds) -> _Told:
    return "joined", "Phone", (SentencePart(printable(event.subject, 80)), SentencePart("can approve now"))


def _domain(event: EventView, _: KnownIds) -> _Told:
    called = SentencePart(f"is trusted as far as was said, and called {printable(event.detail, 40)}")
    return "allowed", "Domain", (SentencePart(printable(event.subject, 80)), called)


def _approval(event: EventView, _: KnownIds) -> _Told:
    what = printable(event.detail.split(" ")[0], 40)
    phone = SentencePart(printable(event.subject, 80))
    return "allowed", "Approved", (SentencePart(APPROVED.get(what, what)), SentencePart("with"), phone)


def _approval_ended(event: EventView, _: KnownIds) -> _Told:
    if event.detail.startswith("done"):
        return None  # what it made has entries of its own
    return "note", "Approval", (SentencePart(printable(event.detail, 200)),)


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
_TELL: Final[Mapping[str, _Tell]] = {
    "pending": _pending,
    "approved": _about("allowed", "Approved", "may join"),
    "denied": _about("refused", "Denied", "may not join"),
    "collected": _collected,
    "certificate": _about("joined", "Joined", "belongs here now", why=False),
    "grant": _grant,
    "revocation": _revocation,
    "list": _plain("note", "Signed", "the list of ended rights, number"),
    "grant request": _grant_request,
    "decision": _decision,
    "invitation": _plain("allowed", "Join code", "made for"),
    "join": _about("note", "Code used", "came with a join code", why=False),
    "invitation ended": _about("ended", "Ended", "can no longer be joined with its code"),
    "imported": _plain("note", "Imported", "from an intermediate:"),
    "restored": _restored,
    "passkey": _passkey,
    "passkey ended": _about("ended", "Removed", "can no longer approve"),
    "approval": _approval,
    "approval ended": _approval_ended,
    "domain": _domain,
    "domain ended": _about("ended", "Domain", "is not trusted any more"),
    "domain list": _plain("note", "Signed", "the list of other domains, number"),
    "thing": _plain("allowed", "Thing", "known with its border router:"),
    "foreign certificate": _plain("note", "Known", "a node of another domain:"),
}
KINDS: Final = _TELL.keys() | _FOLDED
"""The kinds of log entries that are told in words of their own, or by another one."""
