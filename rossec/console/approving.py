"""What a form asks to be approved: its fields become the arguments of `prepare`.

`READERS` has every kind that a page can prepare. A form has exactly the fields of its kind, each
once, and none is completed but a typed name: what was typed is what is approved, or nothing is. The
service checks all of it again; here a mistake is told to the person before the phone is asked.
"""

import base64
import binascii
import re
from collections.abc import Awaitable, Callable, Mapping
from typing import Final, NamedTuple, Protocol

from ca.encoding import Value
from ca.names import check_name, check_wildcard, is_master_name
from ca.patterns import check_pattern
from ca.requests import MAX_REQUEST
from rossec import clock
from rossec.authority.console.views import GrantQuestion, IdentityRequestView, Outcome
from rossec.console import words
from rossec.console.enrollment import Enrollment
from rossec.console.made_codes import MadeCodes
from rossec.errors import FormRefused

DAY: Final = 86400
IDENTITY_LIFETIME: Final = 30 * DAY
DELEGATION_LIFETIME: Final = 90 * DAY
INTERMEDIATE_LIFETIME: Final = 90 * DAY
MAX_USES: Final = 10_000
MAX_REASON: Final = 200
GRANT_DURATIONS: Final = ("today", "week", "month", "open")
INVITATION_DURATIONS: Final[Mapping[str, int]] = {"hour": 3600, "day": DAY, "week": 7 * DAY}
TICKETS: Final[Mapping[str, int]] = {"hour": 3600, "eight-hours": 8 * 3600, "day": DAY}
_SECONDS: Final[Mapping[str, int]] = {"week": 7 * DAY, "month": 30 * DAY, "open": 0}
_PEM: Final = re.compile(
    r"\s*-----BEGIN CERTIFICATE REQUEST-----([A-Za-z0-9+/=\s]+)-----END CERTIFICATE REQUEST-----\s*"
)
_RELOAD: Final = "load the page anew, and decide again"

Form = Mapping[str, str]


class Act(NamedTuple):
    """What is to be approved; `next` is the page afterwards, `{id}` in it the approval's id."""

    kind: str
    arguments: list[Value]
    next: str
    subject: str = ""  # of the page: the id of an enrollment


class RunningEnrollments(Protocol):
    """`Enrollments`, as far as approving needs it."""

    def get(self, number: str) -> Enrollment:
        """The enrollment, or raise EnrollmentUnknown."""
        ...

    def approved(self, number: str, outcome: Outcome) -> None:
        """Its request was approved."""
        ...


class RequestSource(Protocol):
    """The service, as far as approving needs it."""

    async def identity_requests(self) -> tuple[IdentityRequestView, ...]:
        """Requests that wait."""
        ...

    async def questions(self) -> tuple[GrantQuestion, ...]:
        """What nodes ask for."""
        ...


class Sources(Protocol):
    """What a form's answers are looked up in; the console's context is one."""

    @property
    def enrollments(self) -> RunningEnrollments:
        """The enrollments that run."""
        ...

    @property
    def made_codes(self) -> MadeCodes:
        """Which session may see a join code."""
        ...

    @property
    def service(self) -> RequestSource:
        """The authority's service."""
        ...


Reader = Callable[[Sources, Form], Awaitable[Act]]


async def read(sources: Sources, kind: str, form: Form) -> Act:
    """What the form of a page asks to be approved.

    Raises:
        FormRefused: an unknown kind, other fields, or a field without an answer.
        HintedError: a name, a pattern or an enrollment that is refused, with its reason.
    """
    if kind not in READERS:
        raise FormRefused(f"nothing of the kind {kind!a} can be approved", _RELOAD)
    expected, reader = READERS[kind]
    if not any(form.keys() == fields for fields in expected):
        raise FormRefused("the form has other fields than its page", _RELOAD)
    return await reader(sources, form)


def carried_out(sources: Sources, act: Act, outcome: Outcome, session: bytes) -> str:
    """Take note of an approval of `session`; returns the page that shows what comes of it."""
    if act.kind == "enroll" and act.subject:
        sources.enrollments.approved(act.subject, outcome)
    if act.kind == "invitation":
        sources.made_codes.add(outcome.id, session)
    return act.next.format(id=base64.urlsafe_b64encode(outcome.id).rstrip(b"=").decode())


async def _enrollment(sources: Sources, form: Form) -> Act:
    number = form["enrollment"]
    found = sources.enrollments.get(number)
    found.check_can_approve()
    request = found.core.request
    replaces = _replaces(form, request.name, is_other_key=found.is_other_key)
    arguments: list[Value] = [
        found.core.csr, found.source, request.wildcard, IDENTITY_LIFETIME, replaces,
    ]  # fmt: skip
    return Act("enroll", arguments, f"/add/{number}", subject=number)


async def _request(sources: Sources, form: Form) -> Act:
    wanted = _octets(form, "request")
    for each in await sources.service.identity_requests():
        if each.id == wanted:
            replaces = _replaces(form, each.name, is_other_key=each.is_other_key)
            arguments: list[Value] = [
                each.csr, each.source, each.anonymous, IDENTITY_LIFETIME, replaces,
            ]  # fmt: skip
            return Act("enroll", arguments, "/approved/{id}")
    raise FormRefused("this request was answered already, or has expired", "see what still waits")


async def _enroll(sources: Sources, form: Form) -> Act:
    return await (_enrollment if "enrollment" in form else _request)(sources, form)


async def _grant(sources: Sources, form: Form) -> Act:
    question, coarse = _octets(form, "question"), form["coarse"]
    if form["duration"] not in GRANT_DURATIONS:
        raise FormRefused("this is not one of the durations", _RELOAD)
    if len(coarse) > MAX_REASON:
        raise FormRefused("this is not the name of a filter", _RELOAD)
    asked = [each for each in await sources.service.questions() if each.id == question]
    if not asked:
        raise FormRefused("this question was answered, or it is too late", "see what still waits")
    seconds = _grant_seconds(form["duration"], asked[0].lifetime)
    return Act("grant", [question, coarse, seconds], "/approved/{id}")


async def _policy(_: Sources, form: Form) -> Act:
    return Act("policy", [_octets(form, "digest")], "/approved/{id}")


async def _delegate(_: Sources, form: Form) -> Act:
    days, ticket = _number(form, "days", 366), _choice(form, "ticket", TICKETS)
    return Act("delegate", [days * DAY, ticket], "/approved/{id}")


async def _intermediate(_: Sources, form: Form) -> Act:
    may_enroll = _choice(form, "may", {"renew": 0, "enroll": 1}) == 1
    lifetime = _number(form, "days", 366) * DAY
    arguments: list[Value] = [certificate_request(form["csr"]), may_enroll, lifetime]
    return Act("intermediate", arguments, "/approved/{id}")


async def _passkey(_: Sources, form: Form) -> Act:
    return Act("passkey", [_octets(form, "proposal")], "/phones")


async def _invitation(_: Sources, form: Form) -> Act:
    pattern, anonymous = check_pattern(form["pattern"]), "anonymous" in form
    if anonymous and form["anonymous"] != "on":
        raise FormRefused("this is not a tick", _RELOAD)
    if anonymous and "*" not in pattern:
        check_wildcard(check_name(pattern))
    uses, seconds = _number(form, "uses", MAX_USES), _choice(form, "lasts", INVITATION_DURATIONS)
    return Act("invitation", [pattern, uses, seconds, anonymous], "/invited/{id}")


async def _revoke_master(_: Sources, form: Form) -> Act:
    master = form["master"]
    if not is_master_name(master):
        raise FormRefused("this is no master", _RELOAD)
    check_typed(form, master)
    return Act("revoke-master", [reason(form), master], f"/revoked/0/0?node={master}")


READERS: Final[Mapping[str, tuple[tuple[frozenset[str], ...], Reader]]] = {
    "enroll": (
        (
            frozenset({"enrollment"}), frozenset({"enrollment", "name"}),
            frozenset({"request"}), frozenset({"request", "name"}),
        ),
        _enroll,
    ),
    "grant": ((frozenset({"question", "coarse", "duration"}),), _grant),
    "policy": ((frozenset({"digest"}),), _policy),
    "delegate": ((frozenset({"days", "ticket"}),), _delegate),
    "intermediate": ((frozenset({"csr", "may", "days"}),), _intermediate),
    "passkey": ((frozenset({"proposal"}),), _passkey),
    "invitation": (
        (
            frozenset({"pattern", "uses", "lasts"}),
            frozenset({"pattern", "uses", "lasts", "anonymous"}),
        ),
        _invitation,
    ),
    "revoke-master": ((frozenset({"reason", "name", "master"}),), _revoke_master),
}  # fmt: skip


def certificate_request(text: str) -> bytes:
    """The DER of a pasted request: PEM, or its base64 alone.

    Raises:
        FormRefused: neither, or too long.
    """
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
    """The reason that a person gives, in one line; it may be empty.

    Raises:
        FormRefused: too long, or with a line break or another control character.
    """
    given = form["reason"]
    if len(given) > MAX_REASON or (given and not given.isprintable()):
        raise FormRefused(f"a reason is one line of at most {MAX_REASON} characters", "shorten it")
    return given


def check_typed(form: Form, name: str) -> None:
    """Return if the person has typed this name: its slash at the beginning may be left out.

    Raises:
        FormRefused: another one.
    """
    if form["name"].strip(" ") not in (name, name.removeprefix("/")):
        raise FormRefused(
            f"you typed {form['name'][:MAX_REASON]!a}, the name is {name}", f"type {name} to go on"
        )


def _replaces(form: Form, name: str, *, is_other_key: bool) -> bool:
    """Whether the key of a known name is to be replaced: then, and only then, it is typed."""
    if is_other_key is not ("name" in form):
        raise FormRefused("what is known of this name has changed meanwhile", _RELOAD)
    if is_other_key:
        check_typed(form, name)
    return is_other_key


def _grant_seconds(duration: str, most: int) -> int:
    """The seconds of a button, of which the policy allows `most`."""
    if duration == "today":
        return min(clock.seconds_left_today(clock.now()), most)
    seconds = _SECONDS[duration]
    if seconds > most:
        raise FormRefused(
            f"the policy allows {words.duration(most)} at most", "choose a shorter time"
        )
    return seconds


def _octets(form: Form, field: str) -> bytes:
    """An identifier, as base64url."""
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
