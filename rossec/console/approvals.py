"""What a phone is asked to approve: forms, acts that wait, and a request for grants in words and pictures.

`READERS` has every kind that a page can prepare: its form's fields become the arguments of `prepare`. A form
has exactly the fields of its kind, each once, and none is completed but a typed name: what was typed is what
is approved, or nothing is. The service makes the statement and checks all of it again; here a mistake is told
to the person before the phone is asked, and an act is carried on only in the session that asked for it. Pure.
"""

import base64
import binascii
import re
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

from ca.bounded import Newest
from ca.encoding import Value
from ca.names import check_name, check_pattern, check_wildcard, is_master_name
from ca.svid import MAX_REQUEST
from grants.document import read_scope
from grants.model import Restriction, Right
from grants.vocabulary.assess import assess
from grants.vocabulary.contents import rank
from rossec import clock
from rossec.authority.console import messages
from rossec.authority.console.messages import (
    ApprovalOutcome,
    AskedRight,
    FactView,
    GrantQuestion,
    IdentityRequestView,
    QuestionAnswer,
)
from rossec.console import samples, words
from rossec.console.enrollments import Enrollment
from rossec.console.matrix import Cell, TopicAccess
from rossec.console.pictures import looks as pictures
from rossec.console.pictures.place import has_place
from rossec.console.samples import Preview
from rossec.console.sentences import SentencePart, wanted
from rossec.errors import FormRefused, HttpRefused
from rossec.peer_limits import SharedTable, printable

MAX_CODES: Final = 64
MAX_PENDING: Final = 256


class MadeCodes:
    """Approvals of join codes, by their id, that were not shown yet; the oldest makes room."""

    def __init__(self) -> None:
        self._sessions: Newest[bytes, bytes] = Newest(MAX_CODES)

    def add(self, approval: bytes, session: bytes) -> None:
        self._sessions[approval] = session

    def take(self, approval: bytes, session: bytes) -> bool:
        # Whether this session may see it, now and not again.
        if self._sessions.get(approval) != session:
            return False
        del self._sessions[approval]
        return True


DAY: Final = 86400
IDENTITY_LIFETIME: Final = 30 * DAY
MAX_USES: Final = 10_000
MAX_REASON: Final = 200
GRANT_DURATIONS: Final = ("today", "week", "month", "open")
INVITATION_DURATIONS: Final[Mapping[str, int]] = {"hour": 3600, "day": DAY, "week": 7 * DAY}
TICKETS: Final[Mapping[str, int]] = {"hour": 3600, "eight-hours": 8 * 3600, "day": DAY}
_SECONDS: Final[Mapping[str, int]] = {"week": 7 * DAY, "month": 30 * DAY, "open": 0}
MAX_PICTURES: Final = 2  # topics
_MOST: Final = 4  # rights in the sentence
ACTS: Final = Right.PUBLISH | Right.CALL | Right.PROVIDE | Right.PARAM_SET | Right.ADMIN
DRIVING: Final = frozenset(
    {
        "geometry_msgs/Twist",
        "geometry_msgs/TwistStamped",
        "ackermann_msgs/AckermannDrive",
        "ackermann_msgs/AckermannDriveStamped",
    }
)
LABELS: Final[Mapping[str, str]] = {
    "": "All of it, as it asks",
    "coarse": "Coarser",
    "coarse-position": "Only roughly where it is",
    "presence-only": "Only that it is there",
    "anonymous-diagnostics": "Only whether its parts are well, without names",
    "blurred-camera": "Only a blurred picture",
}
"""What a filter is called: rossec's own ones. One of the policy has the name that it has there."""
_PEM: Final = re.compile(
    r"\s*-----BEGIN CERTIFICATE REQUEST-----([A-Za-z0-9+/=\s]+)-----END CERTIFICATE REQUEST-----\s*"
)
_RELOAD: Final = "load the page anew, and decide again"

Form = Mapping[str, str]


class ProposedAct(NamedTuple):
    kind: str
    arguments: list[Value]
    next: str
    subject: str = ""  # of the page: the id of an enrollment


class RunningEnrollments(Protocol):
    def get(self, number: str) -> Enrollment: ...

    def approved(self, number: str, outcome: ApprovalOutcome) -> None: ...


class RequestSource(Protocol):
    async def identity_requests(self) -> tuple[IdentityRequestView, ...]: ...

    async def questions(self) -> tuple[GrantQuestion, ...]: ...


class ApprovalSources(Protocol):
    @property
    def enrollments(self) -> RunningEnrollments: ...

    @property
    def made_codes(self) -> MadeCodes: ...

    @property
    def service(self) -> RequestSource: ...


Reader = Callable[[ApprovalSources, Form], Awaitable[ProposedAct]]


async def read(sources: ApprovalSources, kind: str, form: Form) -> ProposedAct:
    if kind not in READERS:
        raise FormRefused(f"nothing of the kind {kind!a} can be approved", _RELOAD)
    expected, reader = READERS[kind]
    if not any(form.keys() == fields for fields in expected):
        raise FormRefused("the form has other fields than its page", _RELOAD)
    return await reader(sources, form)


def carried_out(sources: ApprovalSources, act: ProposedAct, outcome: ApprovalOutcome, session: bytes) -> str:
    if act.kind == "enroll" and act.subject:
        sources.enrollments.approved(act.subject, outcome)
    if act.kind == "invitation":
        sources.made_codes.add(outcome.id, session)
    return act.next.format(id=base64.urlsafe_b64encode(outcome.id).rstrip(b"=").decode())


async def _enroll(sources: ApprovalSources, form: Form) -> ProposedAct:
    arguments: list[Value]
    if "enrollment" in form:
        number = form["enrollment"]
        found = sources.enrollments.get(number)
        found.check_can_approve()
        request = found.core.request
        replaces = _replaces(form, request.name, is_other_key=found.is_other_key)
        arguments = [found.core.csr, found.source, request.wildcard, IDENTITY_LIFETIME, replaces]
        return ProposedAct("enroll", arguments, f"/add/{number}", subject=number)
    wanted = _octets(form, "request")
    for each in await sources.service.identity_requests():
        if each.id == wanted:
            replaces = _replaces(form, each.name, is_other_key=each.is_other_key)
            arguments = [each.csr, each.source, each.anonymous, IDENTITY_LIFETIME, replaces]
            return ProposedAct("enroll", arguments, "/approved/{id}")
    raise FormRefused("this request was answered already, or has expired", "see what still waits")


async def _grant(sources: ApprovalSources, form: Form) -> ProposedAct:
    question, coarse = _octets(form, "question"), form["coarse"]
    if form["duration"] not in GRANT_DURATIONS:
        raise FormRefused("this is not one of the durations", _RELOAD)
    if len(coarse) > MAX_REASON:
        raise FormRefused("this is not the name of a filter", _RELOAD)
    asked = [each for each in await sources.service.questions() if each.id == question]
    if not asked:
        raise FormRefused("this question was answered, or it is too late", "see what still waits")
    most = asked[0].lifetime
    if form["duration"] == "today":
        seconds = min(clock.seconds_left_today(clock.now()), most)
    else:
        seconds = _SECONDS[form["duration"]]
    if seconds > most:
        raise FormRefused(f"the policy allows {words.duration(most)} at most", "choose a shorter time")
    return ProposedAct("grant", [question, coarse, seconds], "/approved/{id}")


async def _delegate(_: ApprovalSources, form: Form) -> ProposedAct:
    days, ticket = _number(form, "days", 366), _choice(form, "ticket", TICKETS)
    return ProposedAct("delegate", [days * DAY, ticket], "/approved/{id}")


async def _intermediate(_: ApprovalSources, form: Form) -> ProposedAct:
    may_enroll = _choice(form, "may", {"renew": 0, "enroll": 1}) == 1
    lifetime = _number(form, "days", 366) * DAY
    arguments: list[Value] = [certificate_request(form["csr"]), may_enroll, lifetime]
    return ProposedAct("intermediate", arguments, "/approved/{id}")


def _of_octets(kind: str, field: str, following: str) -> Reader:
    async def act(_: ApprovalSources, form: Form) -> ProposedAct:
        return ProposedAct(kind, [_octets(form, field)], following)

    return act


async def _invitation(_: ApprovalSources, form: Form) -> ProposedAct:
    pattern, anonymous = check_pattern(form["pattern"]), "anonymous" in form
    if anonymous and form["anonymous"] != "on":
        raise FormRefused("this is not a tick", _RELOAD)
    if anonymous and "*" not in pattern:
        check_wildcard(check_name(pattern))
    uses, seconds = _number(form, "uses", MAX_USES), _choice(form, "lasts", INVITATION_DURATIONS)
    return ProposedAct("invitation", [pattern, uses, seconds, anonymous], "/invited/{id}")


async def _revoke_master(_: ApprovalSources, form: Form) -> ProposedAct:
    master = form["master"]
    if not is_master_name(master):
        raise FormRefused("this is no master", _RELOAD)
    check_typed(form, master)
    return ProposedAct("revoke-master", [reason(form), master], f"/revoked/0/0?node={master}")


READERS: Final[Mapping[str, tuple[tuple[frozenset[str], ...], Reader]]] = {
    "enroll": (
        tuple(frozenset({what, *name}) for what in ("enrollment", "request") for name in ((), ("name",))),
        _enroll,
    ),
    "grant": ((frozenset({"question", "coarse", "duration"}),), _grant),
    "policy": ((frozenset({"digest"}),), _of_octets("policy", "digest", "/approved/{id}")),
    "delegate": ((frozenset({"days", "ticket"}),), _delegate),
    "intermediate": ((frozenset({"csr", "may", "days"}),), _intermediate),
    "passkey": ((frozenset({"proposal"}),), _of_octets("passkey", "proposal", "/phones")),
    "invitation": (
        (frozenset({"pattern", "uses", "lasts"}), frozenset({"pattern", "uses", "lasts", "anonymous"})),
        _invitation,
    ),
    "revoke-master": ((frozenset({"reason", "name", "master"}),), _revoke_master),
}


def certificate_request(text: str) -> bytes:
    pem = _PEM.fullmatch(text)
    digits = "".join((pem[1] if pem else text).split())
    hint = "on the host: base64 intermediate.csr, and paste all of it"
    try:
        found = base64.b64decode(digits, validate=True)
    except (binascii.Error, ValueError) as error:
        raise FormRefused("this is not a request of a host", hint) from error
    if not 0 < len(found) <= MAX_REQUEST:
        raise FormRefused(f"a request has at most {MAX_REQUEST} bytes", hint)
    return found


def reason(form: Form) -> str:
    given = form["reason"]
    if len(given) > MAX_REASON or (given and not given.isprintable()):
        raise FormRefused(f"a reason is one line of at most {MAX_REASON} characters", "shorten it")
    return given


def check_typed(form: Form, name: str) -> None:
    if form["name"].strip(" ") not in (name, name.removeprefix("/")):
        raise FormRefused(
            f"you typed {form['name'][:MAX_REASON]!a}, the name is {name}", f"type {name} to go on"
        )


def _replaces(form: Form, name: str, *, is_other_key: bool) -> bool:
    # Whether the key of a known name is to be replaced: then, and only then, it is typed.
    if is_other_key is not ("name" in form):
        raise FormRefused("what is known of this name has changed meanwhile", _RELOAD)
    if is_other_key:
        check_typed(form, name)
    return is_other_key


def _octets(form: Form, field: str) -> bytes:
    if not re.fullmatch(r"[A-Za-z0-9_-]{2,120}", form[field], re.ASCII):
        raise FormRefused(f"the field {field} is no identifier", _RELOAD)
    try:
        return base64.b64decode(form[field] + "=" * (-len(form[field]) % 4), altchars=b"-_")
    except binascii.Error as error:
        raise FormRefused(f"the field {field} is no identifier", _RELOAD) from error


def _number(form: Form, field: str, most: int) -> int:
    text = form[field]
    if not re.fullmatch(r"[1-9][0-9]{0,5}", text, re.ASCII) or int(text) > most:
        raise FormRefused(f"{field} is a number from 1 to {most}", "change it, and go on")
    return int(text)


def _choice(form: Form, field: str, choices: Mapping[str, int]) -> int:
    if form[field] not in choices:
        raise FormRefused(f"{field} is one of {', '.join(choices)}", _RELOAD)
    return choices[form[field]]


class PendingActs:
    """Acts that are shown to a phone and not approved yet, with the session that asked."""

    def __init__(self) -> None:
        self._acts: SharedTable[bytes, tuple[bytes, ProposedAct]] = SharedTable(MAX_PENDING)

    def add(self, statement: bytes, session: bytes, act: ProposedAct, owner: str = "") -> None:
        who = owner or messages.of_looker(session)
        if self._acts.add(statement, (session, act), who, messages.rank(who)) is None:
            raise HttpRefused("too much waits for a phone", "approve that, or wait", status=429)

    def get(self, statement: bytes, session: bytes) -> ProposedAct:
        found = self._acts.get(statement)
        if found is None or found[0] != session:
            raise HttpRefused("this was not asked here", "load the page again", status=404)
        return found[1]

    def remove(self, statement: bytes) -> None:
        self._acts.pop(statement)


class ApprovalWay(NamedTuple):
    """A way to approve: through the filter `coarse` (empty: none); one line for each right.

    `exact` is what each line leaves out; `is_narrowest`: no other way shows less.
    """

    coarse: str
    label: str
    lines: tuple[tuple[SentencePart, ...], ...]
    exact: tuple[str, ...]
    is_narrowest: bool


class OfferedDuration(NamedTuple):
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


def sentence(question: GrantQuestion, facts: Iterable[FactView]) -> tuple[SentencePart, ...]:
    senders: dict[str, set[str]] = {}
    for fact in facts:
        if fact.kind == "publisher":
            senders.setdefault(fact.name, set()).add(fact.node)
    parts = [SentencePart(words.name(question.node), is_name=True), SentencePart("wants to")]
    shown = question.rights[:_MOST]
    for place, right in enumerate(shown):
        parts += [SentencePart("and to")] if place else []
        known = sorted(senders.get(right.pattern, ()))
        topic = SentencePart(words.topic(right.pattern), is_name=True)
        if drives(right):
            parts += [SentencePart("drive: send commands to"), topic]
        elif right.right == Right.SUBSCRIBE and has_place(right.type) and len(known) == 1:
            parts += [
                SentencePart("see where"),
                SentencePart(words.name(known[0]), is_name=True),
                SentencePart("is"),
            ]
        else:
            parts += [SentencePart(wanted(right.right)), topic]
    if len(question.rights) > len(shown):
        parts.append(SentencePart(f"and {len(question.rights) - len(shown)} more things"))
    return tuple(parts)


def ways(given: Sequence[tuple[str, Sequence[AskedRight]]], most: int = 6) -> list[ApprovalWay]:
    """What the node would get, in words; the narrowest first, as it asks last.

    Of more than `most` those that show least, and what it asks for.
    """
    narrow = sorted(given, key=lambda each: strictness(each[1]), reverse=True)
    shown = [*[each for each in narrow if each[0]][: most - 1], *(each for each in given if not each[0])]
    return [
        ApprovalWay(
            coarse,
            LABELS.get(coarse, f"Coarser: {printable(coarse, 80)}"),
            tuple(_line(right) for right in rights),
            tuple(filter(None, (words.restrictions(_restrictions(right)) for right in rights))),
            coarse == narrow[0][0],
        )
        for coarse, rights in shown
    ]


def strictness(rights: Iterable[AskedRight]) -> tuple[int, float, int]:
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
    node: str, ways: Sequence[tuple[str, Sequence[AskedRight]]], preview: Preview | None = None
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


def durations(question: GrantQuestion, now: int) -> list[OfferedDuration]:
    """The four buttons; none promises more than the policy gives."""
    most, today = question.lifetime, clock.seconds_left_today(now)
    allowed = words.duration(most)
    too_long = f"the policy allows {allowed}"
    return [
        OfferedDuration("today", "Today", words.duration(min(today, most)), True),
        OfferedDuration("week", "For a week", "" if most >= 7 * DAY else too_long, most >= 7 * DAY),
        OfferedDuration("month", "For a month", "" if most >= 30 * DAY else too_long, most >= 30 * DAY),
        OfferedDuration("open", "Until I end it", f"at most {allowed}, says the policy", True),
    ]


def answer(given: QuestionAnswer) -> tuple[SentencePart, ...]:
    """`/lamp may not see /robot/camera`."""
    verb = "may" if given.answer == "granted" else "may not"
    return (
        SentencePart(words.name(given.node), is_name=True),
        SentencePart(f"{verb} {wanted(given.right)}"),
        SentencePart(words.topic(given.pattern), is_name=True),
    )


def drives(right: AskedRight) -> bool:
    name = right.pattern.rpartition("/")[2]
    is_driving = right.type in DRIVING or name.endswith("cmd_vel")
    return right.right == Right.PUBLISH and is_driving


def _line(right: AskedRight) -> tuple[SentencePart, ...]:
    said = words.plain(_restrictions(right))
    return (
        SentencePart(wanted(right.right)),
        SentencePart(words.topic(right.pattern), is_name=True),
        SentencePart(f"({said})" if said else "(all of it)"),
    )


def _restrictions(right: AskedRight) -> tuple[Restriction, ...]:
    permissions = read_scope(right.permissions)
    return tuple(each.restriction for each in permissions if each.restriction is not None)


def _looks(
    node: str, right: AskedRight, ways: Sequence[tuple[str, Sequence[AskedRight]]], preview: Preview | None
) -> Looks | None:
    recorded = None if preview is None else preview.recorded(right.pattern)
    applied = [each for _, rights in ways for one in rights for each in _restrictions(one)]
    recorded = recorded or samples.recorded(right.pattern, right.type, applied)
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
        access = TopicAccess.COARSE if restrictions else TopicAccess.ALL
        text = words.plain(restrictions)
        cell = Cell(node, right.pattern, access, text, restrictions=restrictions)
        drawn += [(name, look) for look in pictures.compare(recorded, [cell]).looks]
    return Looks(right.pattern, recorded.is_made_up, tuple(drawn), pictures.minutes(recorded))
