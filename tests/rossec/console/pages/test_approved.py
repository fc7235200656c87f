"""The page of what came of an approval."""

import pytest

from ca.approvals.passkeys import base64url
from ca.approvals.statement import StatementKind
from ca.encoding import encode
from grants.document import from_draft, peek
from rossec.authority.console.messages import ApprovalOutcome, ApprovalView
from rossec.console.words import day
from tests.support.consolehome import HOSTILE
from tests.support.consolepages import Browser

NUMBER = b"\7" * 16
PATH = f"/approved/{base64url(NUMBER)}"


def approved(state: str, kind: int = 2, data: bytes = b"", result: str = "") -> Browser:
    browser = Browser().log_in()
    browser.home.outcomes[NUMBER] = ApprovalOutcome(NUMBER, state, result, data)
    (view,) = browser.home.approvals
    browser.home.approvals = [view._replace(kind=int(kind))]
    return browser


@pytest.mark.parametrize(
    ("state", "says", "is_live"),
    [
        ("done", "Done", False),
        ("waiting", "The key is locked", True),
        ("expired", "Too late", False),
        ("failed", "That did not work", False),
    ],
)
def test_each_state_is_told(state: str, says: str, is_live: bool) -> None:
    browser = approved(state, result="why it is so")
    browser.home.remaining = None
    text = browser.get(PATH).text
    assert says in text
    assert "the doctor may see where the robot is" in text
    assert "why it is so" in text
    assert ("data-live" in text) is is_live


def test_what_waits_for_the_master_is_not_said_to_wait_for_the_key() -> None:
    text = approved("waiting").get(PATH).text
    assert "It is not done yet" in text
    assert "the master has to answer" in text
    assert "locked" not in text
    assert "data-live" in text


def test_what_a_person_carries_to_a_host_is_shown() -> None:
    browser = approved("done", StatementKind.INTERMEDIATE, b"-----BEGIN CERT")
    assert "BEGIN CERT" in browser.get(PATH).text


@pytest.mark.parametrize("kind", sorted({*StatementKind} - {StatementKind.INTERMEDIATE}))
def test_nothing_else_that_was_made_is_shown_here(kind: StatementKind) -> None:
    text = approved("done", kind, b"ROSSEC-JOIN:X").get(PATH).text
    assert "ROSSEC-JOIN" not in text


def test_what_was_given_is_told_and_until_when_not_what_was_asked() -> None:
    coarse = peek(Browser().home.grants[2].data)
    data = encode([encode(from_draft(coarse, coarse.issuer))])
    browser = approved("done", StatementKind.GRANT, data, "some words")
    (view,) = browser.home.approvals
    browser.home.approvals = [view._replace(sentence="what /heating asked for")]
    text = browser.get(PATH).text
    assert "/heating" in text
    assert "position to 0.5 m" in text
    assert f"until {day(coarse.cap)}" in text
    assert "asked for" not in text
    for malformed in (b"\xff", encode(5), encode([b"x"]), encode([5])):
        other = approved("done", StatementKind.GRANT, malformed, "some words")
        assert "some words" in other.get(PATH).text


def test_an_approval_of_another_number_is_not_there() -> None:
    assert Browser().log_in().get(PATH).status_code == 422


def test_an_approval_that_is_not_listed_any_more_has_its_outcome() -> None:
    browser = approved("done")
    browser.home.approvals = [ApprovalView(b"x", 99, "", "", 0, "done", "")]
    assert "Done" in browser.get(PATH).text


def test_texts_are_data() -> None:
    browser = approved("failed", result=HOSTILE)
    (view,) = browser.home.approvals
    browser.home.approvals = [view._replace(sentence=HOSTILE, phone=HOSTILE, kind=99)]
    text = browser.get(PATH).text
    assert "<script>alert" not in text
    assert "\u202e" not in text
