"""What a phone is asked to approve: forms, acts that wait, and a request for grants in words and pictures.

`READERS` has every kind that a page can prepare: its form's fields become the arguments of `prepare`. The
service makes the statement and checks all of it again; here a mistake is told to the person before the phone
is asked. Pure.
"""

import base64
import binascii
import re
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

from ca.approvals.passkeys import base64url
from ca.encoding import Value
from ca.names import check_name, check_pattern, check_wildcard, is_master_name
from ca.svid import MAX_REQUEST
from grants.document import read_scope
from grants.model import Restriction, Right
from grants.vocabulary.assess import assess
from grants.vocabulary.contents import rank
from rossec import clock
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
from rossec.console.sentences import Sayable, SentencePart, name_part, say, topic_part, wanted
from rossec.console.sessions import SessionTable
from rossec.errors import FormRefused
from rossec.peer_limits import printable

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
    {f"geometry_msgs/Twist{end}" for end in ("", "Stamped")}
    | {f"ackermann_msgs/AckermannDrive{end}" for end in ("", "Stamped")}
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
_Ways = Sequence[tuple[str, Sequence[AskedRight]]]  # what is asked for, by the filter it would pass


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
    def made_codes(self) -> SessionTable[bool]: ...

    @property
    def service(self) -> RequestSource: ...


Reader = Callable[[ApprovalSources, Form], Awaitable[ProposedAct]]
READERS: Final[dict[str, tuple[tuple[frozenset[str], ...], Reader]]] = {}
"""By kind: the fields that its forms may have, and what makes an act of them."""


def _reads(kind: str, *forms: set[str]) -> Callable[[Reader], Reader]:
    def add(reader: Reader) -> Reader:
        READERS[kind] = tuple(map(frozenset, forms)), reader
        return reader

    return add


async def read(sources: ApprovalSources, kind: str, form: Form) -> ProposedAct:
    if kind not in READERS:
        raise FormRefused(f"nothing of the kind {kind!a} can be approved", _RELOAD)
    # Exactly the fields of its kind, and none is completed: what was typed is what is approved, or nothing
    # is.
    expected, reader = READERS[kind]
    if not any(form.keys() == fields for fields in expected):
        raise FormRefused("the form has other fields than its page", _RELOAD)
    return await reader(sources, form)


def carried_out(sources: ApprovalSources, act: ProposedAct, outcome: ApprovalOutcome, session: bytes) -> str:
    if act.kind == "enroll" and act.subject:
        sources.enrollments.approved(act.subject, outcome)
    if act.kind == "invitation":
        sources.made_codes.add(outcome.id, session, True, "")  # the oldest makes room
    return act.next.format(id=base64url(outcome.id))


@_reads("enroll", {"enrollment"}, {"enrollment", "name"}, {"request"}, {"request", "name"})
async def _enroll(sources: ApprovalSources, form: Form) -> ProposedAct:
    # A form only points to a request: what is signed is what the node sent, never fields that a page carried.
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


@_reads("grant", {"question", "coarse", "duration"})
async def _grant(sources: ApprovalSources, form: Form) -> ProposedAct:
    question, coarse = _octets(form, "question"), form["coarse"]
    if form["duration"] not in GRANT_DURATIONS:
        raise FormRefused("this is not one of the durations", _RELOAD)
    if len(coarse) > MAX_REASON:  # whether the policy has such a filter, the service knows
        raise FormRefused("this is not the name of a filter", _RELOAD)
    asked = [each for each in await sources.service.questions() if each.id == question]
    if not asked:
        raise FormRefused("this question was answered, or it is too late", "see what still waits")
    most = asked[0].lifetime
    left = clock.seconds_left_today(clock.now())
    seconds = min(left, most) if form["duration"] == "today" else _SECONDS[form["duration"]]
    if seconds > most:  # nothing is shortened without a word
        raise FormRefused(f"the policy allows {words.duration(most)} at most", "choose a shorter time")
    return ProposedAct("grant", [question, coarse, seconds], "/approved/{id}")


@_reads("delegate", {"days", "ticket"})
async def _delegate(_: ApprovalSources, form: Form) -> ProposedAct:
    days, ticket = _number(form, "days", 366), _choice(form, "ticket", TICKETS)
    return ProposedAct("delegate", [days * DAY, ticket], "/approved/{id}")


@_reads("intermediate", {"csr", "may", "days"})
async def _intermediate(_: ApprovalSources, form: Form) -> ProposedAct:
    may_enroll = _choice(form, "may", {"renew": 0, "enroll": 1}) == 1
    lifetime = _number(form, "days", 366) * DAY
    arguments: list[Value] = [certificate_request(form["csr"]), may_enroll, lifetime]
    return ProposedAct("intermediate", arguments, "/approved/{id}")


@_reads("policy", {"digest"})
async def _policy(_: ApprovalSources, form: Form) -> ProposedAct:
    return ProposedAct("policy", [_octets(form, "digest")], "/approved/{id}")


@_reads("passkey", {"proposal"})
async def _passkey(_: ApprovalSources, form: Form) -> ProposedAct:
    return ProposedAct("passkey", [_octets(form, "proposal")], "/phones")


@_reads("invitation", {"pattern", "uses", "lasts"}, {"pattern", "uses", "lasts", "anonymous"})
async def _invitation(_: ApprovalSources, form: Form) -> ProposedAct:
    pattern, anonymous = check_pattern(form["pattern"]), "anonymous" in form
    if anonymous and form["anonymous"] != "on":
        raise FormRefused("this is not a tick", _RELOAD)
    if anonymous and "*" not in pattern:
        check_wildcard(check_name(pattern))
    uses, seconds = _number(form, "uses", MAX_USES), _choice(form, "lasts", INVITATION_DURATIONS)
    return ProposedAct("invitation", [pattern, uses, seconds, anonymous], "/invited/{id}")


@_reads("revoke-master", {"reason", "name", "master"})
async def _revoke_master(_: ApprovalSources, form: Form) -> ProposedAct:
    master = form["master"]
    if not is_master_name(master):
        raise FormRefused("this is no master", _RELOAD)
    check_typed(form, master)
    return ProposedAct("revoke-master", [reason(form), master], f"/revoked/0/0?node={master}")


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
        said = f"you typed {form['name'][:MAX_REASON]!a}, the name is {name}"
        raise FormRefused(said, f"type {name} to go on")


def _replaces(form: Form, name: str, *, is_other_key: bool) -> bool:
    # Whether the key of a known name is to be replaced: then, and only then, it is typed.
    if is_other_key is not ("name" in form):
        raise FormRefused("what is known of this name has changed meanwhile", _RELOAD)
    if is_other_key:
        check_typed(form, name)
    return is_other_key


def _octets(form: Form, field: str) -> bytes:
    # `b64decode` skips what is not in the alphabet, so many texts would be one id (RFC 4648 section 3.3).
    if not re.fullmatch(r"[A-Za-z0-9_-]{2,120}", form[field], re.ASCII):
        raise FormRefused(f"the field {field} is no identifier", _RELOAD)
    try:
        return base64.b64decode(form[field] + "=" * (-len(form[field]) % 4), altchars=b"-_")
    except binascii.Error as error:
        raise FormRefused(f"the field {field} is no identifier", _RELOAD) from error


def _number(form: Form, field: str, most: int) -> int:
    # `int` takes digits of every script, signs, spaces and underscores: people see others than are meant.
    text = form[field]
    if not re.fullmatch(r"[1-9][0-9]{0,5}", text, re.ASCII) or int(text) > most:
        raise FormRefused(f"{field} is a number from 1 to {most}", "change it, and go on")
    return int(text)


def _choice(form: Form, field: str, choices: Mapping[str, int]) -> int:
    if form[field] not in choices:
        raise FormRefused(f"{field} is one of {', '.join(choices)}", _RELOAD)
    return choices[form[field]]


class ApprovalWay(NamedTuple):
    coarse: str  # the filter; empty: none
    label: str
    lines: tuple[Sayable, ...]  # one for each right
    exact: tuple[str, ...]  # what each line leaves out
    is_narrowest: bool  # no other way shows less


class OfferedDuration(NamedTuple):
    value: str
    label: str
    detail: str
    is_possible: bool


class Looks(NamedTuple):
    topic: str
    is_made_up: bool
    pictures: tuple[tuple[str, pictures.Look], ...]  # by the filter through which the node would see it
    minutes: int = 1


def sentence(question: GrantQuestion, facts: Iterable[FactView]) -> Sayable:
    senders: dict[str, set[str]] = {}
    for fact in facts:
        if fact.kind == "publisher":
            senders.setdefault(fact.name, set()).add(fact.node)
    parts: list[SentencePart | str] = [name_part(question.node), "wants to"]
    shown = question.rights[:_MOST]
    for place, right in enumerate(shown):
        parts += ["and to"] if place else []
        known = sorted(senders.get(right.pattern, ()))
        if drives(right):
            parts += ["drive: send commands to", topic_part(right.pattern)]
        elif right.right == Right.SUBSCRIBE and has_place(right.type) and len(known) == 1:
            parts += ["see where", name_part(known[0]), "is"]
        else:
            parts += [wanted(right.right), topic_part(right.pattern)]
    if len(question.rights) > len(shown):
        parts.append(f"and {len(question.rights) - len(shown)} more things")
    return say(*parts)


def ways(given: _Ways, most: int = 6) -> list[ApprovalWay]:
    """What the node would get, in words; the narrowest first, as it asks last."""
    # Of more than `most` those that show least, and what it asks for.
    narrow = sorted(given, key=lambda each: strictness(each[1]), reverse=True)
    shown = [*[each for each in narrow if each[0]][: most - 1], *(each for each in given if not each[0])]
    found = []
    for coarse, rights in shown:
        title = LABELS.get(coarse, f"Coarser: {printable(coarse, 80)}")
        exact, lines = list[str](), list[Sayable]()
        for right in rights:
            restrictions = _restrictions(right)
            exact += filter(None, [words.restrictions(restrictions)])
            said = words.plain(restrictions) or "all of it"
            lines.append(say(wanted(right.right), topic_part(right.pattern), f"({said})"))
        found.append(ApprovalWay(coarse, title, tuple(lines), tuple(exact), coarse == narrow[0][0]))
    return found


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


def looks(node: str, ways: _Ways, preview: samples.Preview | None = None) -> list[Looks]:
    """What the node would see, of topics whose messages can be drawn."""
    seen = [
        each for each in ways[0][1] if each.right == Right.SUBSCRIBE and each.type and "*" not in each.pattern
    ]
    found = [_looks(node, each, ways, preview) for each in seen]
    return [each for each in found if each is not None][:MAX_PICTURES]


def durations(question: GrantQuestion, now: int) -> list[OfferedDuration]:
    """The four buttons; none promises more than the policy gives."""
    most, today = question.lifetime, clock.seconds_left_today(now)
    allowed = words.duration(most)
    found = [OfferedDuration("today", "Today", words.duration(min(today, most)), True)]
    for value, title in (("week", "For a week"), ("month", "For a month")):
        fits = most >= _SECONDS[value]
        found.append(OfferedDuration(value, title, "" if fits else f"the policy allows {allowed}", fits))
    return [*found, OfferedDuration("open", "Until I end it", f"at most {allowed}, says the policy", True)]


def answer(given: QuestionAnswer) -> Sayable:
    """`/lamp may not see /robot/camera`."""
    verb = "may" if given.answer == "granted" else "may not"
    return say(name_part(given.node), f"{verb} {wanted(given.right)}", topic_part(given.pattern))


def drives(right: AskedRight) -> bool:
    is_driving = right.type in DRIVING or right.pattern.endswith("cmd_vel")
    return right.right == Right.PUBLISH and is_driving


def _restrictions(right: AskedRight) -> tuple[Restriction, ...]:
    permissions = read_scope(right.permissions)
    return tuple(each.restriction for each in permissions if each.restriction is not None)


def _looks(node: str, right: AskedRight, ways: _Ways, preview: samples.Preview | None) -> Looks | None:
    applied = [each for _, rights in ways for one in rights for each in _restrictions(one)]
    recorded = samples.recorded(right.pattern, right.type, applied, preview)
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
