"""Approving a policy, and delegating: what was shown is put in force, or nothing."""

from hashlib import sha256
from pathlib import Path

import pytest

from ca.approvals.statement import PolicyChange, Statement
from ca.errors import StoreError
from grants.renewal import OpenDelegation, open_delegation
from rossec.authority.console.approved_acts import NONE_BEFORE
from rossec.authority.signing import delegations
from rossec.errors import ConfigurationError, KeyServiceRefused
from rossec.ros.names import MASTER
from tests.support.consoleacts import DAY, POLICY, Acts

MORE = POLICY.replace("[/pose]}}", "[/pose, /odom]}}", 1)
LESS = POLICY.replace("subscribe: [/pose]", "publish: [/odom]", 1)


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    acts = Acts(tmp_path / "home")
    assert acts.enroll("/fleet/a").state == "done"
    assert acts.grants("/fleet/a") == 1
    return acts


def write(acts: Acts, text: str) -> bytes:
    (acts.home.path / "policy.yaml").write_text(text)
    return sha256(text.encode()).digest()


def test_a_policy_is_put_in_force_in_the_right_order(acts: Acts) -> None:
    digest = write(acts, LESS)
    prepared = acts.prepare("policy", digest)
    what = Statement.from_bytes(prepared.statement).what
    assert isinstance(what, PolicyChange)
    assert (what.old, what.new) == (NONE_BEFORE, digest)
    assert prepared.payload == LESS.encode()
    acts.pass_time(100)
    outcome = acts.touch(prepared)
    assert (outcome.state, outcome.result) == ("done", "1 grant signed, 1 revoked")
    methods = [call.method for call in acts.calls]
    assert methods == ["rossec.depositGrants", "rossec.updateRevocations"]
    with acts.store() as store:
        assert len(store.unrevoked_grants()) == 1
        assert acts.home.count_unlisted(acts.now) == 0
    acts.audit_record()


def test_the_next_policy_names_the_one_before(acts: Acts) -> None:
    first = write(acts, MORE)
    assert acts.approve("policy", first).state == "done"
    prepared = acts.prepare("policy", write(acts, LESS))
    what = Statement.from_bytes(prepared.statement).what
    assert isinstance(what, PolicyChange)
    assert what.old == first


def test_of_two_policies_that_were_shown_one_is_put_in_force(acts: Acts) -> None:
    first = acts.prepare("policy", write(acts, MORE))
    again = acts.prepare("policy", write(acts, MORE))
    assert acts.touch(first).state == "done"
    with pytest.raises(StoreError, match="another policy was approved"):
        acts.touch(again)


@pytest.mark.parametrize("is_approved", [False, True])
def test_a_file_that_changed_since_is_not_applied(acts: Acts, is_approved: bool) -> None:
    prepared = acts.prepare("policy", write(acts, MORE))
    acts.lock()
    waits = acts.touch(prepared) if is_approved else None
    write(acts, LESS)
    if waits is None:
        with pytest.raises(ConfigurationError, match="changed since"):
            acts.touch(prepared)
    else:
        acts.unlock()
        acts.approving.carry_out_waiting()
        assert "changed since it was shown" in acts.outcome(waits.id).result
    assert acts.grants("/fleet/a") == 1


def test_a_policy_that_would_do_something_else_by_now_is_not_applied(acts: Acts) -> None:
    prepared = acts.prepare("policy", write(acts, MORE))
    acts.lock()
    waits = acts.touch(prepared)
    with acts.store() as store:
        (row,) = store.grants()
    acts.removals.revoke_grant(row.id, "another person")
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert "not what was approved" in acts.outcome(waits.id).result
    assert acts.grants("/fleet/a") == 1


def test_what_the_master_did_not_take_is_done_all_the_same(
    acts: Acts, caplog: pytest.LogCaptureFixture
) -> None:
    acts.reachable = False
    outcome = acts.approve("policy", write(acts, LESS))
    assert outcome.state == "done"
    assert acts.woken, "a round delivers it"


def test_a_policy_in_force_and_wrong_arguments_are_refused(acts: Acts) -> None:
    with pytest.raises(ConfigurationError, match="in force already"):
        acts.prepare("policy", write(acts, POLICY))
    with pytest.raises(ConfigurationError, match="changed since"):
        acts.prepare("policy", bytes(32))
    for kind in ("policy", "delegate"):
        with pytest.raises(KeyServiceRefused, match="arguments"):
            acts.prepare(kind, "x")


def test_a_delegation_is_done_when_the_master_has_it(acts: Acts) -> None:
    acts.enroll_master()
    acts.reachable = False
    outcome = acts.approve("delegate", 30 * DAY, 3600)
    assert outcome.state == "waiting"
    assert len(_delegations(acts)) == 1
    acts.pass_time(50)
    acts.reachable = True
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).result == f"{MASTER} may renew grants"
    (given,) = _delegations(acts)
    assert (given.expires, given.max_ttl) == (acts.now - 50 - 60 + 30 * DAY, 3600)
    (call,) = [call for call in acts.calls if call.method == "rossec.updateDelegation"]
    assert isinstance(call.statement[0], bytes)
    assert open_delegation(call.statement[0], acts.home.own_key()).id == given.id


def test_a_master_with_another_key_gets_no_delegation(acts: Acts) -> None:
    with pytest.raises(StoreError, match="no valid identity"):
        acts.prepare("delegate", DAY, 3600)
    acts.enroll_master()
    prepared = acts.prepare("delegate", DAY, 3600)
    acts.lock()
    waits = acts.touch(prepared)
    acts.unlock()
    assert acts.approve("revoke-master", "stolen", "/master").state == "done"
    acts.enroll_master()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).result == f"{MASTER} has another key now"
    assert not _delegations(acts)


@pytest.mark.parametrize("given", [(91 * DAY, 3600), (DAY, 59), (0, 3600), (DAY, 8 * DAY)])
def test_times_of_a_delegation_are_bounded(acts: Acts, given: tuple[int, int]) -> None:
    with pytest.raises(KeyServiceRefused, match="at most"):
        acts.prepare("delegate", *given)


def _delegations(acts: Acts) -> list[OpenDelegation]:
    return delegations(acts.home.path, acts.home.own_key())
