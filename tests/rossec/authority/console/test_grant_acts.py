"""Approving what a node asks for: the grants are signed exactly as they were shown."""

from hashlib import sha256
from pathlib import Path

import pytest

from ca.encoding import Value, encode
from ca.errors import StoreError
from grants import document
from grants.document import GRANT
from rossec.authority.console.grant_acts import Answer
from rossec.authority.requests import GrantRequestStore
from rossec.errors import ConfigurationError, KeyServiceRefused
from tests.support.consoleacts import POLICY, Acts

SHA = bytes(32)


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    return Acts(tmp_path / "home")


def signed(acts: Acts) -> list[bytes]:
    with acts.store() as store:
        return [row.data for row in store.grants()]


def test_grants_are_signed_as_they_were_shown(acts: Acts) -> None:
    question = acts.ask("/map")
    prepared = acts.prepare("grant", question, "", 3600)
    shown = Answer.from_bytes(prepared.payload)
    acts.pass_time(200)
    outcome = acts.touch(prepared)
    assert (outcome.state, outcome.result) == ("done", "/map has what it asked for")
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
        5, [], [SHA, []], [SHA, [["a", 1]], []], [SHA, [[1, "/a"]], [[1, ""]]], [SHA, [], [[b"x"]]],
        ["x", [], []],
    ],
)  # fmt: skip
def test_a_payload_of_another_form_is_refused(value: Value) -> None:
    with pytest.raises(ConfigurationError, match="malformed"):
        Answer.from_bytes(encode(value))


def test_a_payload_comes_back() -> None:
    answer = Answer(sha256(b"p").digest(), ((2, "/pose"),), ((b"claims", "a"), (b"more", "")))
    assert Answer.from_bytes(answer.to_bytes()) == answer
