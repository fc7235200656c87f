"""From the fields of a form to the arguments of `prepare`: exactly these, or a refusal."""

import base64
from dataclasses import dataclass, field
from typing import Any

import pytest

from ca.errors import EnrollmentOver, HintedError, NameRefused, PatternRefused
from rossec.authority.console.messages import PREPARED, ApprovalOutcome, GrantQuestion, IdentityRequestView
from rossec.console import approvals
from rossec.console.approvals import DAY, ProposedAct, carried_out, certificate_request, read
from rossec.console.enrollments import Enrollment
from rossec.console.sessions import SessionTable
from rossec.errors import FormRefused, RossecError

QUESTION = "q" * 22
KITCHEN = "/master/kitchen"
TYPED = {"name": "/master", "master": "/master"}
QUESTION_ID = base64.urlsafe_b64decode(QUESTION + "==")
WAITS = IdentityRequestView(b"\1" * 32, "/arm", b"k", "invitation", 0, 9, "pending", False, False, b"csr")
KNOWN = WAITS._replace(id=b"\2" * 32, is_other_key=True)


@dataclass
class Request:
    name: str = "/fridge"
    wildcard: bool = False


@dataclass
class Core:
    request: Request = field(default_factory=Request)
    csr: bytes = b"csr"


@dataclass
class Adding:
    """An enrollment as its page left it."""

    is_other_key: bool = False
    over: bool = False
    core: Core = field(default_factory=Core)
    source: str = "a screen at 127.0.0.1:9"

    def check_can_approve(self) -> None:
        if self.over:
            raise EnrollmentOver("it is over")


class Sources:
    """The console's context, as far as approving needs it."""

    def __init__(self, **enrollments: Adding) -> None:
        self.known = enrollments
        self.heard: list[tuple[str, ApprovalOutcome]] = []
        self.enrollments: Any = self
        self.service: Any = self
        self.made_codes: SessionTable[bool] = SessionTable(4)
        self.lifetime = 7 * DAY  # of what is asked for

    def get(self, number: str) -> Enrollment:
        if number not in self.known:
            raise RossecError("there is none")
        found: Any = self.known[number]
        return found  # type: ignore[no-any-return]

    def approved(self, number: str, outcome: ApprovalOutcome) -> None:
        self.heard.append((number, outcome))

    async def identity_requests(self) -> tuple[IdentityRequestView, ...]:
        return WAITS, KNOWN

    async def questions(self) -> tuple[GrantQuestion, ...]:
        return (GrantQuestion(QUESTION_ID, "/map", b"k", "", 0, 9, self.lifetime, (), ()),)


SOURCES = Sources(e1=Adding(), e2=Adding(is_other_key=True), e3=Adding(over=True))
ENROLL = [b"csr", "a screen at 127.0.0.1:9", False, 30 * DAY]
JOIN = [b"csr", "invitation", False, 30 * DAY]
INVITATION = {"pattern": "/cam/*", "uses": "3", "lasts": "hour"}
DIGITS = base64.b64encode(b"request").decode()
GIVEN: list[tuple[str, dict[str, str], list[object], str]] = [
    ("enroll", {"enrollment": "e1"}, [*ENROLL, False], "/add/e1"),
    ("enroll", {"enrollment": "e2", "name": "/fridge"}, [*ENROLL, True], "/add/e2"),
    ("enroll", {"request": "AQEB" * 10 + "AQE"}, [*JOIN, False], "/approved/{id}"),
    ("enroll", {"request": "AgIC" * 10 + "AgI", "name": "/arm"}, [*JOIN, True], "/approved/{id}"),
    (
        "grant",
        {"question": QUESTION, "coarse": "room", "duration": "week"},
        [QUESTION_ID, "room", 7 * DAY],
        "/approved/{id}",
    ),
    (
        "grant",
        {"question": QUESTION, "coarse": "", "duration": "open"},
        [QUESTION_ID, "", 0],
        "/approved/{id}",
    ),
    ("policy", {"digest": "A" * 43}, [bytes(32)], "/approved/{id}"),
    ("delegate", {"days": "90", "ticket": "eight-hours"}, [90 * DAY, 8 * 3600], "/approved/{id}"),
    (
        "intermediate",
        {"csr": DIGITS, "may": "enroll", "days": "1"},
        [b"request", True, DAY],
        "/approved/{id}",
    ),
    ("passkey", {"proposal": "Cg"}, [b"\n"], "/phones"),
    ("invitation", INVITATION, ["/cam/*", 3, 3600, False], "/invited/{id}"),
    ("invitation", INVITATION | {"anonymous": "on"}, ["/cam/*", 3, 3600, True], "/invited/{id}"),
    (
        "revoke-master",
        {"reason": "lost", "name": KITCHEN, "master": KITCHEN},
        ["lost", KITCHEN],
        "/revoked/0/0?node=/master/kitchen",
    ),
]


@pytest.mark.parametrize(("kind", "form", "arguments", "following"), GIVEN)
async def test_a_form_becomes_the_arguments_of_its_kind(
    kind: str, form: dict[str, str], arguments: list[object], following: str
) -> None:
    act = await read(SOURCES, kind, form)
    assert (act.kind, act.arguments, act.next) == (kind, arguments, following)
    assert tuple(map(type, act.arguments)) == PREPARED[kind]


def test_every_kind_of_the_service_has_a_form() -> None:
    assert approvals.READERS.keys() == PREPARED.keys()
    assert {kind for kind, *_ in GIVEN} == PREPARED.keys()


@pytest.mark.parametrize(("kind", "form", "arguments", "following"), GIVEN)
async def test_a_form_with_a_field_more_or_less_is_refused(
    kind: str, form: dict[str, str], arguments: list[object], following: str
) -> None:
    with pytest.raises(FormRefused, match="other fields"):
        await read(SOURCES, kind, form | {"more": "1"})
    for name in form.keys() - {"name", "anonymous"}:
        with pytest.raises(FormRefused, match="other fields"):
            await read(SOURCES, kind, {key: form[key] for key in form.keys() - {name}})


GRANT = {"question": QUESTION, "coarse": "", "duration": "week"}
REFUSED: list[tuple[str, dict[str, str], type[HintedError], str]] = [
    ("lift", {}, FormRefused, "nothing of the kind 'lift'"),
    ("enroll", {"enrollment": "e9"}, RossecError, "there is none"),
    ("enroll", {"enrollment": "e3"}, EnrollmentOver, "it is over"),
    ("enroll", {"enrollment": "e2"}, FormRefused, "has changed meanwhile"),
    ("enroll", {"enrollment": "e1", "name": "/fridge"}, FormRefused, "has changed meanwhile"),
    ("enroll", {"enrollment": "e2", "name": "/fridges"}, FormRefused, "the name is /fridge"),
    ("enroll", {"enrollment": "e2", "name": "//fridge"}, FormRefused, "the name is /fridge"),
    ("enroll", {"enrollment": "e2", "name": "Fridge"}, FormRefused, "the name is /fridge"),
    ("enroll", {"enrollment": "e2", "name": ""}, FormRefused, "the name is /fridge"),
    ("enroll", {"request": "AwMD" * 10 + "AwM"}, FormRefused, "answered already"),
    ("enroll", {"request": "AgIC" * 10 + "AgI"}, FormRefused, "has changed meanwhile"),
    ("grant", GRANT | {"question": "a+/b"}, FormRefused, "is no identifier"),
    ("grant", GRANT | {"question": ""}, FormRefused, "is no identifier"),
    ("grant", GRANT | {"question": "qqqqq"}, FormRefused, "is no identifier"),
    ("grant", GRANT | {"question": "q" * 121}, FormRefused, "is no identifier"),
    ("grant", GRANT | {"duration": "month"}, FormRefused, "the policy allows 7 days at most"),
    ("grant", GRANT | {"question": "r" * 22}, FormRefused, "was answered"),
    ("grant", GRANT | {"duration": "always"}, FormRefused, "not one of the durations"),
    ("grant", GRANT | {"coarse": "x" * 201}, FormRefused, "not the name of a filter"),
    ("delegate", {"days": "0", "ticket": "day"}, FormRefused, "days is a number from 1"),
    ("delegate", {"days": "367", "ticket": "day"}, FormRefused, "to 366"),
    ("delegate", {"days": "+1", "ticket": "day"}, FormRefused, "days is a number"),
    ("delegate", {"days": "1", "ticket": "year"}, FormRefused, "ticket is one of hour"),
    ("intermediate", {"csr": "?", "may": "renew", "days": "1"}, FormRefused, "not a request"),
    ("intermediate", {"csr": DIGITS, "may": "all", "days": "1"}, FormRefused, "may is one of"),
    ("invitation", INVITATION | {"pattern": "cam"}, PatternRefused, "cam"),
    ("invitation", INVITATION | {"uses": "10001"}, FormRefused, "uses is a number from 1"),
    ("invitation", INVITATION | {"uses": "\N{FULLWIDTH DIGIT ONE}"}, FormRefused, "a number"),
    ("invitation", INVITATION | {"lasts": "year"}, FormRefused, "lasts is one of"),
    ("invitation", INVITATION | {"anonymous": "yes"}, FormRefused, "not a tick"),
    ("invitation", INVITATION | {"pattern": "/master", "anonymous": "on"}, NameRefused, "a single node"),
    ("revoke-master", {"reason": "a\nb"} | TYPED, FormRefused, "one line"),
    ("revoke-master", TYPED | {"reason": "", "name": KITCHEN}, FormRefused, "the name is /master"),
    ("revoke-master", {"reason": "", "name": "/a", "master": "/a"}, FormRefused, "no master"),
]


@pytest.mark.parametrize(("kind", "form", "error", "text"), REFUSED)
async def test_a_field_without_an_answer_is_refused(
    kind: str, form: dict[str, str], error: type[HintedError], text: str
) -> None:
    with pytest.raises(error, match=text):
        await read(SOURCES, kind, form)


@pytest.mark.parametrize("typed", ["/fridge", "fridge", " fridge ", "/fridge "])
async def test_a_typed_name_counts_without_its_slash(typed: str) -> None:
    act = await read(SOURCES, "enroll", {"enrollment": "e2", "name": typed})
    assert act.arguments[4] is True


async def test_today_is_not_longer_than_the_policy() -> None:
    sources = Sources()
    sources.lifetime = 61
    act = await read(sources, "grant", GRANT | {"duration": "today"})
    assert act.arguments[2] in (60, 61)
    with pytest.raises(FormRefused, match="1 minute at most"):
        await read(sources, "grant", GRANT)


async def test_today_ends_before_tomorrow() -> None:
    act = await read(SOURCES, "grant", GRANT | {"duration": "today"})
    seconds = act.arguments[2]
    assert isinstance(seconds, int)
    assert 60 <= seconds <= DAY


def test_a_request_is_read_as_pem_or_as_its_base64() -> None:
    begin, end = (f"-----{word} CERTIFICATE REQUEST-----" for word in ("BEGIN", "END"))
    assert certificate_request(f" {begin}\r\n{DIGITS}\r\n{end}\n") == b"request"
    assert certificate_request(f"{DIGITS[:4]}\n{DIGITS[4:]}\n") == b"request"
    with pytest.raises(FormRefused, match="at most 2048 bytes"):
        certificate_request(base64.b64encode(bytes(2049)).decode())
    with pytest.raises(FormRefused):
        certificate_request("")


def test_the_page_after_an_approval_is_the_one_of_its_kind() -> None:
    sources, outcome = Sources(), ApprovalOutcome(b"\xab" * 16, "done", "", b"")
    act = ProposedAct("enroll", [], "/add/e1", subject="e1")
    assert carried_out(sources, act, outcome, b"session") == "/add/e1"
    assert sources.heard == [("e1", outcome)]
    assert carried_out(sources, ProposedAct("policy", [], "/approved/{id}"), outcome, b"session") == (
        "/approved/q6urq6urq6urq6urq6urqw"
    )
    assert len(sources.heard) == 1


def test_a_join_code_is_for_the_session_that_made_it() -> None:
    sources, outcome = Sources(), ApprovalOutcome(b"\xab" * 16, "done", "", b"code")
    carried_out(sources, ProposedAct("invitation", [], "/invited/{id}"), outcome, b"session")
    assert not sources.made_codes.pop(outcome.id, b"another")
    assert sources.made_codes.pop(outcome.id, b"session")
