"""What nodes ask for: as the policy would grant it, coarser, shorter."""

from pathlib import Path

import pytest

from ca.errors import HintedError, StoreError
from grants.document import read_scope
from grants.errors import PolicyRefused
from grants.model import Right
from grants.request import RequestedRight
from rossec.authority.console.grant_requests import MAX_SECONDS, Questions, Removals, changed_by, pending_of
from rossec.authority.console.messages import AskedRight, GrantQuestion, QuestionAnswer
from rossec.authority.grant_queue import GrantRequestQueue
from rossec.authority.policyfile import PolicyFile
from rossec.errors import ConfigurationError, KeyServiceRefused
from tests.support.consolework import NOW, ConsoleWork, ask, many

POLICY = """rossec: 1
robot: r
defaults: {decision: deny, prompt_timeout: 60s}
types: {/pose: geometry_msgs/PoseStamped}
filters: {room: {pose.position: {round: {step: 2.0}}}}
rules:
  - {id: a, who: /heating, allow: {subscribe: [/temperature]}}
  - {id: p, who: "*", prompt: {call: [/lift], subscribe: [/pose]},
     lifetime: 1h, why: "it is ours"}
"""
POSE = RequestedRight(Right.SUBSCRIBE, "/pose")
LIFT = RequestedRight(Right.CALL, "/lift")
TEMPERATURE = RequestedRight(Right.SUBSCRIBE, "/temperature")
DOOR = RequestedRight(Right.CALL, "/door")


@pytest.fixture
def site(tmp_path: Path) -> ConsoleWork:
    site = ConsoleWork(tmp_path)
    site.work.policy_path().write_text(POLICY)
    return site


@pytest.fixture
def questions(site: ConsoleWork) -> Questions:
    return Questions(site.work)


def test_a_question_is_what_waits_for_a_person(site: ConsoleWork, questions: Questions) -> None:
    node = site.enroll("/heating")
    number = site.ask_for(node, POSE, TEMPERATURE, DOOR, why="to be <b>warm</b>")
    (question,) = many(GrantQuestion, ask(questions, "questions"))
    assert (question.request, question.node) == (number, "/heating")
    assert question.why == "to be <b>warm</b>"
    assert question.key == site.home.store().valid_certificate("/heating", NOW).thumbprint
    assert (question.at, question.expires, question.lifetime) == (NOW, NOW + 60, 3600)
    (right,) = question.rights
    assert right[:5] == (int(Right.SUBSCRIBE), "/pose", "geometry_msgs/PoseStamped", "p", "it is ours")
    (permission,) = read_scope(right.permissions)
    assert (permission.pattern, permission.restriction) == ("/pose", None)
    assert question.coarse[0] == "room"
    assert "coarse-position" in question.coarse
    site.wait(61)
    assert ask(questions, "questions") == [], "denied: nobody answered"


def test_considering_shows_what_would_be_granted(site: ConsoleWork, questions: Questions) -> None:
    number = site.ask_for(site.enroll("/heating"), POSE)
    ask(questions, "questions")
    (plain,) = many(AskedRight, ask(questions, "consider", number, "", 0))
    (coarse,) = many(AskedRight, ask(questions, "consider", number, "room", 600))
    (permission,) = read_scope(coarse.permissions)
    assert permission.restriction is not None
    assert permission.restriction.filters[0].operator == "round"
    assert plain.permissions != coarse.permissions
    with pytest.raises(ConfigurationError, match="no filter 'fog'"):
        ask(questions, "consider", number, "fog", 0)
    with pytest.raises(StoreError, match="was answered"):
        ask(questions, "consider", bytes(16), "", 0)
    for seconds in (-1, MAX_SECONDS + 1):
        with pytest.raises(KeyServiceRefused, match="no time for a grant"):
            ask(questions, "consider", number, "", seconds)


def test_only_what_is_subscribed_can_be_coarse(site: ConsoleWork, questions: Questions) -> None:
    number = site.ask_for(site.enroll("/heating"), POSE, LIFT)
    found = {each.rights[0].pattern: each for each in many(GrantQuestion, ask(questions, "questions"))}
    assert found["/lift"].coarse == ()
    assert "room" in found["/pose"].coarse, "what else it asks for is a question of its own"
    assert {each.request for each in found.values()} == {number}
    (right,) = many(AskedRight, ask(questions, "consider", found["/pose"].id, "room", 0))
    assert right.pattern == "/pose"
    for question in (number, found["/lift"].id):
        with pytest.raises(HintedError):
            ask(questions, "consider", question, "room", 0)


def test_how_a_question_was_answered_is_told(site: ConsoleWork, questions: Questions) -> None:
    number = site.ask_for(site.enroll("/heating"), POSE)
    ask(questions, "questions")
    assert ask(questions, "question-answers", number) == []
    Removals(site.work, lambda: None).deny_question(number, "not you")
    (answer,) = many(QuestionAnswer, ask(questions, "question-answers", number))
    assert answer == QuestionAnswer("/heating", int(Right.SUBSCRIBE), "/pose", "denied", "not you", NOW)
    assert ask(questions, "question-answers", bytes(16)) == []


def test_questions_of_several_nodes_are_apart(site: ConsoleWork, questions: Questions) -> None:
    asked = {site.ask_for(site.enroll(name), POSE) for name in ("/heating", "/doctor")}
    assert {each.id for each in many(GrantQuestion, ask(questions, "questions"))} == asked


def test_without_a_policy_nobody_asks(site: ConsoleWork, questions: Questions) -> None:
    site.ask_for(site.enroll("/heating"), POSE)
    site.work.policy_path().unlink()
    assert ask(questions, "questions") == []


def test_a_policy_with_mistakes_is_refused(site: ConsoleWork, questions: Questions) -> None:
    site.work.policy_path().write_text("rossec: 1\nrules: 5\n")
    with pytest.raises(PolicyRefused):
        ask(questions, "questions")


def test_changed_by_shortens_and_pending_of_finds_one(site: ConsoleWork) -> None:
    number = site.ask_for(site.enroll("/heating"), POSE)
    file = PolicyFile.read(site.work.policy_path())
    queue = GrantRequestQueue(site.home, file, NOW)
    queue.read_inbox()
    (found,) = pending_of(queue, number)
    assert changed_by(file, "", 0, NOW)(found.verdict).lifetime == 3600
    assert changed_by(file, "", 60, NOW)(found.verdict).lifetime == 60
    assert changed_by(file, "", 7200, NOW)(found.verdict).lifetime == 3600, "never longer"
    queue.close()
