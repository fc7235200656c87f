"""The pages of a node that is being added, stage by stage."""

from typing import Any

import pytest

from ca.enrollment import qr
from ca.errors import (
    CodeRefused,
    ConflictingOffer,
    EnrollmentExpired,
    EnrollmentOver,
    HintedError,
    RequestSwapped,
)
from rossec.authority.console import messages
from rossec.console.enrollments import Destination, Enrollment, Enrollments, RecordedName, Stage
from rossec.console.rendering import MAX_FRAME
from rossec.console.server.control import WebSettings
from rossec.errors import RossecError, ScannerBusy
from tests.support.consolepages import ORIGIN, Browser
from tests.support.enrolling import Robot, clock, compared

NUMBER = "ab" * 16


class Adding:
    """Enrollments with one of them, as its page finds it."""

    def __init__(self) -> None:
        core = compared(Robot("/fridge").enrollment(now=clock()), clock())
        self.begun: list[tuple[str, str]] = []
        self.rejected: list[str] = []
        self.differing: list[str] = []
        self.refusal: HintedError | None = None
        service: Any = None
        where = Destination("192.168.1.7", 11317, "a screen")
        self.found = Enrollment(core, where, service, clock, lambda: None)
        self.found.stage = Stage.COMPARED
        self.found.reject = self.reject  # type: ignore[method-assign]

    def get(self, number: str) -> Enrollment:
        if number != NUMBER:
            return Enrollments(None, "home", clock, lambda: None).get(number)  # type: ignore[arg-type]
        return self.found

    def begin(self, text: str, address: str, owner: str) -> str:
        assert owner == messages.of_phone("Anna's phone")
        if self.refusal is not None:
            raise self.refusal
        self.begun.append((text, address))
        return NUMBER

    async def reject(self) -> None:
        self.rejected.append(NUMBER)

    async def differ(self, number: str) -> None:
        self.differing.append(number)


def added(adding: Adding, **context: Any) -> Browser:
    browser = Browser(**context).log_in()
    browser.context.enrollments = adding  # type: ignore[assignment]
    return browser


def test_a_code_that_is_pasted_leads_to_the_page_of_its_node() -> None:
    adding = Adding()
    answer = added(adding).post("/add", data={"code": " ROSSEC:X \n"})
    assert (answer.status_code, answer.headers["location"]) == (303, f"/add/{NUMBER}")
    assert adding.begun == [("ROSSEC:X", "")]


def test_what_is_wrong_with_a_code_is_said_where_it_was_pasted() -> None:
    adding = Adding()
    adding.refusal = CodeRefused("this is not the text of a rossec code", "scan it again")
    answer = added(adding).post("/add", data={"code": '"><script>'})
    assert answer.status_code == 422
    assert "This is not the text of a rossec code" in answer.text
    assert "Scan it again" in answer.text
    assert 'value="&#34;&gt;&lt;script&gt;"' in answer.text
    assert 'name="address"' not in answer.text


def test_a_label_asks_for_the_address_of_its_node() -> None:
    adding = Adding()
    adding.refusal = CodeRefused("this code is a label", "type the address")
    browser, code = added(adding), qr.label_code(b"x")
    assert 'name="address"' in browser.post("/add", data={"code": code}).text
    adding.refusal = None
    browser.post("/add", data={"code": code, "address": "192.168.1.7"})
    assert adding.begun == [(code, "192.168.1.7")]


def test_the_first_page_takes_a_code_in_three_ways() -> None:
    text = added(Adding()).get("/add").text
    assert "data-camera" in text
    assert 'type="file"' in text
    assert 'name="code"' in text
    assert "scan.js" in text


class Scanner:
    def __init__(self, answer: str | HintedError | None) -> None:
        self.answer, self.frames = answer, list[bytes]()

    async def read(self, frame: bytes) -> str | None:
        self.frames.append(frame)
        if isinstance(self.answer, HintedError):
            raise self.answer
        return self.answer


JPEG = {"content-type": "image/jpeg", "accept": "application/json"}


@pytest.mark.parametrize(
    ("answer", "status", "body"),
    [
        ("ROSSEC:X", 200, {"text": "ROSSEC:X"}),
        (None, 200, {"text": ""}),
        (ScannerBusy("busy"), 429, {"text": ""}),
        (RossecError("too dark", "light"), 422, {"error": "too dark", "hint": "light"}),
    ],
)
def test_a_frame_is_read_by_the_scanner(
    answer: str | HintedError | None, status: int, body: dict[str, str]
) -> None:
    scanner = Scanner(answer)
    found = Browser(scanner=scanner).log_in().post("/add/frame", content=b"jpeg", headers=JPEG)
    assert (found.status_code, found.json()) == (status, body)
    assert scanner.frames == [b"jpeg"]


def test_what_is_no_picture_does_not_reach_the_scanner() -> None:
    scanner = Scanner("ROSSEC:X")
    browser = Browser(scanner=scanner).log_in()
    assert browser.post("/add/frame", data={"code": "x"}).status_code == 415
    large = browser.post("/add/frame", content=bytes(MAX_FRAME + 1), headers=JPEG)
    assert large.status_code == 413
    assert Browser().log_in().post("/add/frame", content=b"x", headers=JPEG).status_code == 503
    assert scanner.frames == []


def test_the_card_shows_all_that_is_decided() -> None:
    adding = Adding()
    text = added(adding).get(f"/add/{NUMBER}").text
    key = adding.found.core.request.thumbprint.hex()
    assert "A node asks to join" in text
    assert f"{key[:4]} {key[4:8]}" in text
    assert "a screen at 192.168.1.7:11317" in text
    assert "this name is new here" in text
    assert "a name for 30 days" in text
    assert "see nothing and send nothing" in text
    assert f'<input type="hidden" name="enrollment" value="{NUMBER}">' in text
    assert text.index(">Approve<") < text.index(">Reject<")
    assert "autofocus>A node" in text
    assert "data-live" in text


def test_a_key_that_changed_is_an_alarm_and_reject_comes_first() -> None:
    adding = Adding()
    adding.found.known = RecordedName.OTHER_KEY
    text = added(adding).get(f"/add/{NUMBER}").text
    assert "The key of a name you know has CHANGED" in text
    assert 'class="card alarm"' in text
    assert text.index(">Reject<") < text.index("It was: replace the key")
    assert '<button class="filled">Reject' in text
    assert 'name="name"' in text
    assert "see nothing" not in text
    assert "the old key is revoked at once" in text


def test_a_known_key_gets_a_new_certificate() -> None:
    adding = Adding()
    adding.found.known = RecordedName.SAME_KEY
    text = added(adding).get(f"/add/{NUMBER}").text
    assert "Yes, with this key" in text
    assert "see nothing" not in text


def test_the_digits_are_shown_in_two_groups_and_confirmed_at_the_node() -> None:
    adding = Adding()
    adding.found.stage, adding.found.core.digits = Stage.DIGITS, "936915"
    text = added(adding).get(f"/add/{NUMBER}").text
    assert '<p class="digits">936 915</p>' in text
    assert "confirm <b>there</b>" in text
    assert f'action="/add/{NUMBER}/differ"' in text
    assert text.count("<form") == 1


@pytest.mark.parametrize(
    ("known", "error", "says"),
    [
        (RecordedName.NEW, None, "is revoked: nothing accepts it"),
        (RecordedName.SAME_KEY, None, "keeps what it had"),
        (RecordedName.NEW, EnrollmentOver("the service is <away>", "try it"), "could not be ended"),
    ],
)
def test_digits_that_differ_end_it_here(known: RecordedName, error: HintedError | None, says: str) -> None:
    adding = Adding()
    adding.found.known, adding.found.error = known, error
    adding.found.stage = Stage.DIFFERED
    browser = added(adding)
    answer = browser.post(f"/add/{NUMBER}/differ")
    assert (answer.status_code, answer.headers["location"]) == (303, f"/add/{NUMBER}")
    assert adding.differing == [NUMBER]
    text = browser.get(f"/add/{NUMBER}").text
    assert "Stopped: the digits differed" in text
    assert says in text
    assert "<away>" not in text
    assert ("/revoke/node/fridge" in text) is (error is not None)


@pytest.mark.parametrize(
    ("stage", "says"),
    [
        (Stage.WAITING, "The key is locked"),
        (Stage.DELIVERING, "Signed. Telling the node"),
        (Stage.REJECTED, "Nothing was signed"),
        (Stage.ENROLLED, "The node has said so itself"),
    ],
)
def test_each_stage_says_what_happens(stage: Stage, says: str) -> None:
    adding = Adding()
    adding.found.stage = stage
    text = added(adding).get(f"/add/{NUMBER}").text
    assert says in text
    assert ("data-live" in text) is (stage in {Stage.WAITING, Stage.DELIVERING})
    assert ("is enrolled" in text) is (stage is Stage.ENROLLED)
    assert "data-approve" not in text


def test_an_enrolled_node_sees_nothing_unless_the_policy_allowed_it_something() -> None:
    adding = Adding()
    adding.found.stage = Stage.ENROLLED
    browser = added(adding)
    assert "It sees nothing yet" in browser.get(f"/add/{NUMBER}").text
    browser.home.grants = [browser.home.grants[1]._replace(node="/fridge")]
    text = browser.get(f"/add/{NUMBER}").text
    assert "It sees nothing yet" not in text
    assert 'href="/node/fridge"' in text


@pytest.mark.parametrize(
    ("error", "says", "is_alarm"),
    [
        (RequestSwapped("not the one", "scan again"), "This is NOT the node", True),
        (ConflictingOffer("two offers", "find the other"), "Somebody else has the code", True),
        (EnrollmentExpired("too <b>late", "a new code"), "That did not work", False),
    ],
)
def test_every_failure_has_its_reason(error: HintedError, says: str, is_alarm: bool) -> None:
    adding = Adding()
    adding.found.fail(error)
    text = added(adding).get(f"/add/{NUMBER}").text
    assert says in text
    assert ('class="card alarm"' in text) is is_alarm
    assert "<b>late" not in text
    assert error.hint[1:] in text


def test_before_the_node_has_answered_there_is_nothing_to_approve() -> None:
    adding = Adding()
    adding.found.stage = Stage.FETCHING
    text = added(adding).get(f"/add/{NUMBER}").text
    assert "Asking the node" in text
    assert "data-approve" not in text


def test_a_person_who_comes_back_too_late_sees_that() -> None:
    adding = Adding()
    late = Enrollment(
        adding.found.core,
        Destination("192.168.1.7", 1, "a screen"),
        None,  # type: ignore[arg-type]
        lambda: clock() + 1000,
        lambda: None,
    )
    late.stage, adding.found = Stage.COMPARED, late
    assert "its code has expired" in added(adding).get(f"/add/{NUMBER}").text


def test_rejecting_needs_only_the_session() -> None:
    adding = Adding()
    answer = added(adding).post(f"/add/{NUMBER}/reject")
    assert (answer.status_code, answer.headers["location"]) == (303, f"/add/{NUMBER}")
    assert adding.rejected == [NUMBER]


def test_an_enrollment_that_is_not_there_is_told() -> None:
    answer = added(Adding()).get(f"/add/{'0' * 32}")
    assert answer.status_code == 422
    assert "no such node" in answer.text


def test_a_screen_that_only_shows_offers_nothing() -> None:
    settings = WebSettings("home", (ORIGIN,), read_only=True)
    browser = added(Adding(), settings=settings)
    assert "<form" not in browser.get("/add").text
    assert "<form" not in browser.get(f"/add/{NUMBER}").text
