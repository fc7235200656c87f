"""Approving what a node asks for: the grants are signed exactly as they were shown."""

from hashlib import sha256
from pathlib import Path

import pytest

from ca.approvals.statement import StatementKind
from ca.encoding import Value, decode, encode
from ca.errors import StoreError
from grants import document
from grants import document as claims
from grants.document import GRANT
from grants.model import ID_SIZE
from rossec.authority.console.grant_requests import GrantAnswer, Questions
from rossec.authority.console.messages import ApprovalView, GrantQuestion
from rossec.authority.console.queries import RecordQueries
from rossec.authority.requests import GrantRequestStore
from rossec.errors import ConfigurationError, KeyServiceRefused
from tests.support.consoleacts import DAY, POLICY, Acts
from tests.support.consolework import many

SHA = bytes(32)
TWO = POLICY.replace("prompt: {subscribe: [/pose]}", "prompt: {subscribe: [/pose, /odom]}")


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    return Acts(tmp_path / "home")


def questions_of(acts: Acts) -> tuple[GrantQuestion, ...]:
    return many(GrantQuestion, Questions(acts.work).questions())


def signed(acts: Acts) -> list[bytes]:
    with acts.store() as store:
        return [row.data for row in store.grants()]


def test_grants_are_signed_as_they_were_shown(acts: Acts) -> None:
    question = acts.ask("/map")
    prepared = acts.prepare("grant", question, "", 3600)
    shown = GrantAnswer.from_bytes(prepared.payload)
    acts.pass_time(200)
    outcome = acts.touch(prepared)
    assert (outcome.state, outcome.result) == (
        "done",
        "/map may subscribe /pose, until 2027-01-15 09:00:00 UTC",
    )
    (data,) = signed(acts)
    assert GRANT.peek_body(data) == shown.grants[0][0]
    grant = document.peek(data)
    assert (grant.subject, grant.expires) == ("/map", acts.now - 200 + 3600)
    with acts.store() as store:
        assert not GrantRequestStore(store.database).unanswered()
    acts.audit_record()


def test_a_coarser_answer_restricts_the_grant(acts: Acts) -> None:
    question = acts.ask("/map")
    acts.approve("grant", question, "coarse-position", 0)
    (data,) = signed(acts)
    (permission,) = document.peek(data).permissions
    assert permission.restriction is not None
    assert permission.restriction.filters
    views = many(ApprovalView, RecordQueries(acts.work, acts.access.last_used).approvals(9))
    (view,) = [each for each in views if each.kind == StatementKind.GRANT]
    for said in (view.sentence, view.result):
        assert said.startswith("/map may subscribe /pose (not all of it), until 20")


def test_what_was_given_is_told_by_its_claims(acts: Acts) -> None:
    outcome = acts.approve("grant", acts.ask("/map"), "coarse-position", 3600)
    match decode(outcome.data):
        case [bytes(body)]:
            found = claims.read_claims(body, bytes(ID_SIZE))
        case _:
            raise AssertionError(outcome.data)
    assert (found.subject, found.expires) == ("/map", acts.now + 3600)
    assert found.permissions[0].restriction is not None


def test_a_time_that_the_policy_does_not_allow_is_refused_and_not_shortened(acts: Acts) -> None:
    question = acts.ask("/map")
    with pytest.raises(KeyServiceRefused, match="allows this for 7d at most"):
        acts.prepare("grant", question, "", 30 * DAY)
    assert acts.approve("grant", question, "", 7 * DAY).state == "done"


def test_each_right_of_a_request_is_approved_by_itself(acts: Acts) -> None:
    (acts.home.path / "policy.yaml").write_text(TWO)
    request = acts.ask("/map", "/pose", "/odom")
    pose, odom = sorted(questions_of(acts), key=lambda each: each.rights[0].pattern, reverse=True)
    assert request not in (pose.id, odom.id)
    assert {pose.request, odom.request} == {request}
    acts.lock()
    waits = acts.approve("grant", pose.id, "", 0)
    assert [each.id for each in questions_of(acts)] == [odom.id]
    acts.removals.deny_question(odom.id, "no")
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).state == "done", "denying one right takes back no other"
    (data,) = signed(acts)
    assert [each.pattern for each in document.peek(data).permissions] == ["/pose"]
    with acts.store() as store:
        told = {
            (stored.requested.pattern, answer)
            for stored, answer, *_ in GrantRequestStore(store.database).answers()
        }
    assert told == {("/pose", "granted"), ("/odom", "denied")}


def test_denying_a_request_takes_back_what_was_approved_of_it(acts: Acts) -> None:
    (acts.home.path / "policy.yaml").write_text(TWO)
    request = acts.ask("/map", "/pose", "/odom")
    acts.lock()
    waits = acts.approve("grant", questions_of(acts)[0].id, "", 0)
    acts.removals.deny_question(request, "no")
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).state == "failed"
    assert not signed(acts)


def test_a_question_is_answered_once(acts: Acts) -> None:
    question = acts.ask("/map")
    first, second = (acts.prepare("grant", question, "", 0) for _ in range(2))
    acts.lock()
    assert acts.touch(first).state == "waiting"
    with pytest.raises(StoreError, match="answered"):
        acts.touch(second)
    with pytest.raises(StoreError, match="answered"):
        acts.prepare("grant", question, "", 0)
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert len(signed(acts)) == 1


def test_a_question_that_was_denied_is_not_approved(acts: Acts) -> None:
    question = acts.ask("/map")
    prepared = acts.prepare("grant", question, "", 0)
    acts.removals.deny_question(question, "no")
    with pytest.raises(StoreError, match="answered"):
        acts.touch(prepared)
    with pytest.raises(StoreError, match="answered"):
        acts.removals.deny_question(question, "no")


def test_an_approval_that_waits_is_taken_back_by_denying(acts: Acts) -> None:
    question = acts.ask("/map")
    acts.lock()
    waits = acts.approve("grant", question, "", 0)
    acts.removals.deny_question(question, "")
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert (acts.outcome(waits.id).state, acts.outcome(waits.id).result) == ("failed", "denied")
    assert not signed(acts)


@pytest.mark.parametrize("is_approved", [False, True])
def test_a_policy_that_changed_meanwhile_ends_it(acts: Acts, is_approved: bool) -> None:
    question = acts.ask("/map")
    prepared = acts.prepare("grant", question, "", 0)
    acts.lock()
    waits = acts.touch(prepared) if is_approved else None
    (acts.home.path / "policy.yaml").write_text(POLICY.replace("prompt", "deny"))
    if waits is None:
        with pytest.raises(ConfigurationError, match="policy was changed"):
            acts.touch(prepared)
    else:
        acts.unlock()
        acts.approving.carry_out_waiting()
        assert acts.outcome(waits.id).result == "the policy was changed meanwhile"
    assert not signed(acts)


def test_a_node_that_has_another_key_by_then_gets_nothing(acts: Acts) -> None:
    question = acts.ask("/map")
    acts.lock()
    waits = acts.approve("grant", question, "", 0)
    acts.removals.revoke_node("/map", "lost")
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).state == "failed"
    assert not signed(acts)


def test_grants_that_are_over_are_not_signed(acts: Acts) -> None:
    question = acts.ask("/map")
    acts.lock()
    waits = acts.approve("grant", question, "", 60)
    acts.pass_time(61)
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert "the grants are over" in acts.outcome(waits.id).result


def test_an_intermediate_and_wrong_arguments_are_refused(acts: Acts) -> None:
    with pytest.raises(KeyServiceRefused, match="arguments"):
        acts.prepare("grant", b"x" * 16, "", -1)
    (acts.home.path / "intermediate.pem").write_bytes((acts.home.path / "ca.pem").read_bytes())
    with pytest.raises(KeyServiceRefused, match="signs no grants"):
        acts.prepare("grant", b"x" * 16, "", 0)


@pytest.mark.parametrize(
    "value",
    [
        5,
        [],
        [SHA, []],
        [SHA, [["a", 1]], []],
        [SHA, [[1, "/a"]], [[1, ""]]],
        [SHA, [], [[b"x"]]],
        ["x", [], []],
    ],
)
def test_a_payload_of_another_form_is_refused(value: Value) -> None:
    with pytest.raises(ConfigurationError, match="malformed"):
        GrantAnswer.from_bytes(encode(value))


def test_a_payload_comes_back() -> None:
    answer = GrantAnswer(sha256(b"p").digest(), ((2, "/pose"),), ((b"claims", "a"), (b"more", "")))
    assert GrantAnswer.from_bytes(answer.to_bytes()) == answer
