"""What happened, in sentences."""

import pytest

from ca.approvals.statement import StatementKind
from ca.store.database import LOGGED_TABLES
from ca.store.values import RequestState
from grants.model import Right
from rossec.authority.console.messages import AskedRight, DenialView, EventView, GrantQuestion
from rossec.console.matrix import Heard
from rossec.console.sentences import (
    APPROVED,
    KINDS,
    KnownIds,
    Sentence,
    SentencePart,
    permission,
    refusals,
    story,
    wanted,
)
from tests.support.consolehome import COARSE, HOSTILE, NOW, demo, sees

NOTHING = KnownIds.of()


def told(what: str, subject: str = "/lamp", detail: str = "", known: KnownIds = NOTHING) -> str:
    found = story([EventView(3, NOW, what, subject, detail)], (), known)
    return found[0].text if found else ""


def texts(sentences: list[Sentence]) -> list[str]:
    return [each.text for each in sentences]


def test_the_story_of_the_demo() -> None:
    home = demo()
    found = story(home.events, home.denials, home.known)
    assert texts(found)[:2] == [
        "Refused /heating asked to see /robot/scan without being allowed to",
        "Ended /doctor may no longer see /robot/camera: the visit is over",
    ]
    assert "Allowed /heating may see /robot/pose (coarse)" in texts(found)
    assert "Allowed /robot may send /robot/pose, /robot/scan, /robot/camera" in texts(found)
    assert "Joined /doctor belongs here now" in texts(found)
    assert [each.at for each in found] == sorted((each.at for each in found), reverse=True)
    assert {each.node for each in found} == {"/robot", "/doctor", "/heating"}


@pytest.mark.parametrize(
    ("what", "detail", "text"),
    [
        ("pending", "code", "Asked /lamp asked to join from code"),
        ("approved", "", "Approved /lamp may join"),
        ("denied", "unknown", "Denied /lamp may not join: unknown"),
        ("collected", "pending", "Expired /lamp asked to join and got no answer"),
        ("collected", "issued", ""),
        ("issued", "", ""),
        ("policy grant", "r1", ""),
        ("certificate", "aa", "Joined /lamp belongs here now"),
        ("grant", "aa", "Allowed /lamp got a right that has ended"),
        ("revocation", "lost", "Ended what has the number /lamp: lost"),
        ("list", "", "Signed the list of ended rights, number /lamp"),
        ("grant request", "aa", "Asked /lamp asked for a right; it is answered"),
        ("decision", "granted /x", ""),
        ("decision", "denied /x", "Denied /lamp was denied what it asked for: /x"),
        ("decision", "no answer /x", "Denied /lamp asked, no answer: /x"),
        ("invitation", "3 uses, aa", "Join code made for /lamp"),
        ("join", "aa", "Code used /lamp came with a join code"),
        ("invitation ended", "", "Ended /lamp can no longer be joined with its code"),
        ("imported", "1f", "Imported from an intermediate: /lamp"),
        ("restored", "from 12 entries", "Restored the record was put back from 12 entries"),
        ("passkey", "aa", "Phone /lamp can approve now"),
        ("passkey ended", "lost", "Removed /lamp can no longer approve: lost"),
        ("approval", "grant 01ab", "Approved a right with /lamp"),
        ("approval", "new_kind 01ab", "Approved new_kind with /lamp"),
        ("approval ended", "done: signed", ""),
        ("approval ended", "expired: too late", "Approval expired: too late"),
        ("domain", "zoo", "Domain /lamp is trusted as far as was said, and called zoo"),
        ("domain ended", "over", "Domain /lamp is not trusted any more: over"),
        ("domain list", "", "Signed the list of other domains, number /lamp"),
        ("thing", "01ab", "Thing known with its border router: /lamp"),
        ("foreign certificate", "aa", "Known a node of another domain: /lamp"),
        ("never heard of", "more", "Never heard of /lamp more"),
    ],
)
def test_an_entry_in_words(what: str, detail: str, text: str) -> None:
    assert told(what, detail=detail) == text


def test_an_approval_is_told_while_the_identity_is_not_issued() -> None:
    approved = EventView(1, NOW, "approved", "/lamp", "")
    issued = EventView(2, NOW, "certificate", "/lamp", "aa")
    assert texts(story([approved], (), NOTHING)) == ["Approved /lamp may join"]
    assert texts(story([approved, issued], (), NOTHING)) == ["Joined /lamp belongs here now"]


def test_a_question_to_join_is_told_until_it_is_answered() -> None:
    asked = EventView(1, NOW, "pending", "/lamp", "code")
    issued = EventView(2, NOW, "certificate", "/lamp", "aa")
    again = EventView(3, NOW, "pending", "/lamp", "code")
    assert texts(story([asked], (), NOTHING)) == ["Asked /lamp asked to join from code"]
    assert texts(story([again, issued, asked], (), NOTHING)) == [
        "Asked /lamp asked to join from code",
        "Joined /lamp belongs here now",
    ]


def test_ids_are_told_as_what_they_are() -> None:
    home = demo()
    key = home.nodes[1].key.hex()
    assert told("revocation", key, "sold", home.known) == (
        "Removed /doctor does not belong here any more: sold"
    )
    asked = AskedRight(int(Right.SUBSCRIBE), "/robot/pose", "", "", "", b"")
    question = GrantQuestion(b"q", "/lamp", b"k", "", 1, 2, 3, (), (asked,), b"r")
    other = question._replace(id=b"p", rights=(asked._replace(right=1, pattern="/cmd_vel"),))
    known = KnownIds.of(questions=[question, other])
    assert told("grant request", detail=b"r".hex(), known=known) == (
        "Asked /lamp asked to see /robot/pose and send /cmd_vel"
    )


def test_what_is_ending_is_not_told_as_ended() -> None:
    home = demo()
    home.heard = Heard()  # nobody knows who has heard
    camera, key = home.grants[2].id.hex(), home.nodes[1].key.hex()
    known = KnownIds.of(home.held, home.nodes, ending=frozenset({camera, key}))
    assert told("revocation", camera, "over", known) == (
        "Ending /doctor may still see /robot/camera, until every node has heard: over"
    )
    assert told("revocation", key, "", known) == (
        "Ending /doctor may still do what it was allowed, until every node has heard"
    )


def test_a_name_is_never_glued() -> None:
    parts = (SentencePart("a"), SentencePart(",", is_name=True), SentencePart(", b"), SentencePart("c"))
    assert Sentence(0, "note", "Said", parts, 1, "").text == "Said a ,, b c"


def test_equal_denials_are_one_sentence() -> None:
    again = [DenialView(NOW - at, "/lamp", 4, "/door") for at in (9, 3, 5)]
    assert texts(refusals([*again, DenialView(NOW, "/lamp", 2, "/door")])) == [
        "Refused /lamp asked to use /door without being allowed to, 3 times",
        "Refused /lamp asked to see /door without being allowed to",
    ]
    assert refusals(again)[0].at == NOW - 3


def test_a_right_that_is_none_is_said_as_it_is() -> None:
    assert wanted(256) == "do something (256) with"
    assert wanted(2) == "see"


def test_a_permission_in_words() -> None:
    assert [part.text for part in permission(sees("/a/**", COARSE))] == [
        "see",
        "everything below /a",
        "(coarse)",
    ]


def test_a_hostile_text_is_one_bounded_line() -> None:
    said = told("denied", HOSTILE, HOSTILE)
    assert "\u202e" not in said
    assert len(said) < 500


def test_many_permissions_are_bounded() -> None:
    home = demo()
    made = home.grant("/doctor", *(sees(f"/t{at}") for at in range(9)), at=NOW)
    said = told("grant", "/doctor", made.id.hex(), home.known)
    assert said == "Allowed /doctor may see /t0, /t1, /t2, /t3 and 5 more"


def test_every_kind_of_entry_and_of_approval_has_words() -> None:
    assert LOGGED_TABLES.keys() | set(RequestState) <= KINDS
    assert {kind.name.lower() for kind in StatementKind} == APPROVED.keys()
