"""Approving: prepared, touched, recorded and carried out once, also when the key comes later."""

from pathlib import Path
from typing import get_type_hints

import pytest

from ca.approvals.statement import Statement, StatementKind
from ca.errors import ApprovalOver, ApprovalRefused, StoreError
from rossec.authority.console.approved_acts import acts_of
from rossec.authority.console.approving import KINDS, WAITS
from rossec.authority.console.messages import PREPARED
from rossec.errors import KeyServiceRefused
from tests.support import refusal_texts
from tests.support.consoleacts import DAY, NOW, Acts


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    return Acts(tmp_path / "home")


def test_every_kind_that_is_prepared_has_an_act_that_takes_these_arguments(acts: Acts) -> None:
    """What the socket admits is what the acts declare, and nothing else."""
    found = acts_of(acts.work, acts.access, str)
    declared = {kind: tuple(get_type_hints(act.prepare).values())[2:-1] for kind, act in found.items()}
    assert {KINDS[name]: arguments for name, arguments in PREPARED.items()} == declared


def test_a_statement_says_what_would_be_done(acts: Acts) -> None:
    csr = acts.csr("/lamp")
    prepared = acts.asks(csr=csr)
    statement = Statement.from_bytes(prepared.statement)
    assert (prepared.id, prepared.challenge) == (statement.id, statement.challenge)
    assert (statement.kind, statement.domain) == (StatementKind.ENROLL, "home")
    assert (statement.made, prepared.until) == (NOW, NOW + 300)
    assert prepared.payload == csr
    assert (prepared.rp_id, prepared.credentials) == ("localhost", (acts.phone.id,))
    with acts.store() as store:
        assert store.log.head(NOW).root == statement.log_root


def test_an_approval_is_recorded_audited_and_carried_out(acts: Acts) -> None:
    outcome = acts.enroll("/lamp")
    assert (outcome.state, outcome.result) == ("done", "/lamp is enrolled")
    approved, signed = acts.audit[-2:]
    assert outcome.id.hex() in approved
    assert 'phone "Ann\'s phone", statement SHA-256' in approved
    assert approved.endswith("approved at the console")
    assert signed.startswith("signs a certificate of /lamp")
    assert approved.removesuffix(": approved at the console") in signed
    assert acts.woken == 1
    acts.audit_record()


def test_nothing_is_recorded_where_the_audit_cannot_be_written(acts: Acts) -> None:
    prepared = acts.asks()
    acts.disk_is_full = True
    with pytest.raises(KeyServiceRefused, match="cannot be written"):
        acts.touch(prepared)
    with acts.store() as store:
        assert not store.approvals.all()
        assert {row.state for row in store.requests.open()} == {"pending"}


def test_a_signature_that_cannot_be_audited_waits(acts: Acts) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    acts.unlock()
    acts.disk_is_full = True
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "waiting"
    acts.disk_is_full = False
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "done"


def test_without_a_phone_nothing_is_prepared(acts: Acts) -> None:
    acts.removals.remove_phone(acts.phone.id, "lost")
    with pytest.raises(ApprovalRefused, match="no phone that could approve"):
        acts.asks()


def test_a_statement_is_used_up_by_a_wrong_touch_too(acts: Acts) -> None:
    prepared = acts.asks()
    with pytest.raises(ApprovalRefused, match=refusal_texts.NOT_VERIFIED):
        acts.touch(prepared, flags=1)
    with pytest.raises(ApprovalRefused, match="not waiting for a touch"):
        acts.touch(prepared)
    assert acts.enroll("/other").state == "done"


def test_what_waits_for_the_key_is_carried_out_at_unlock(acts: Acts) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    assert (outcome.state, outcome.data) == ("waiting", b"")
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "waiting"
    acts.unlock()
    acts.approving.carry_out_waiting()
    done = acts.outcome(outcome.id)
    assert (done.state, done.data[:10]) == ("done", b"-----BEGIN")
    signed = len(acts.audit)
    acts.approving.carry_out_waiting()
    assert len(acts.audit) == signed, "once"
    acts.audit_record()


def test_what_waits_is_carried_out_by_a_service_that_was_restarted(acts: Acts) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    acts.start()
    acts.pass_time(WAITS - 1)  # the request of the node expires a day after its approval
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "done"


@pytest.mark.parametrize("restarts", [False, True])
def test_what_waits_too_long_comes_to_nothing(acts: Acts, restarts: bool) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    if restarts:
        acts.start()
    for _ in range(2):  # what another process recorded is counted from when it was first seen
        acts.pass_time(300 + WAITS + 1)
        acts.approving.carry_out_waiting()
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "expired"
    with acts.store() as store:
        assert not store.identities.by_name("/lamp")


@pytest.mark.attack("clock-ahead")
@pytest.mark.parametrize("restarts", [False, True])
def test_a_clock_that_is_ahead_for_one_look_ends_nothing(acts: Acts, restarts: bool) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    if restarts:
        acts.start()
    acts.unlock()
    right, acts.now = acts.now, acts.now + 4000 * WAITS
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "waiting"
    acts.now = right
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "done"


def test_what_is_refused_when_it_is_carried_out_has_failed_with_the_reason(acts: Acts) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    with acts.store() as store:  # as a command does
        (row,) = store.requests.open()
        store.requests.deny(row.digest, acts.now, "not mine")
    acts.unlock()
    acts.approving.carry_out_waiting()
    ended = acts.outcome(outcome.id)
    assert (ended.state, ended.result) == ("failed", "the request of /lamp was denied: not mine")


def test_what_is_refused_at_once_is_not_recorded(acts: Acts) -> None:
    first, second = acts.asks(csr=(csr := acts.csr())), acts.asks(csr=csr)
    assert acts.touch(first).state == "done"
    acts.lock()
    again = acts.asks("/other", csr=(other := acts.csr("/other")))
    twice = acts.asks("/other", csr=other)
    assert acts.touch(again).state == "waiting"
    with pytest.raises(StoreError, match="approved and cannot be approved"):
        acts.touch(twice)
    with acts.store() as store:
        assert len(store.approvals.all()) == 2
    assert acts.touch(second).state == "waiting", "an answer that was lost is given again"


def test_an_unknown_approval_has_no_outcome(acts: Acts) -> None:
    prepared = acts.asks()
    with pytest.raises(ApprovalOver):
        acts.outcome(prepared.id)


def test_a_crash_of_what_follows_leaves_it_done(acts: Acts, caplog: pytest.LogCaptureFixture) -> None:
    (acts.home.path / "policy.yaml").write_text("rossec: [")
    outcome = acts.enroll("/fleet/x")
    assert outcome.state == "done"
    assert "/fleet/x has no grants yet" in caplog.text


def test_a_clock_that_was_set_back_carries_nothing_out(acts: Acts) -> None:
    acts.lock()
    outcome = acts.enroll("/lamp")
    acts.start()
    acts.now -= DAY
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "waiting"
    acts.now += DAY
    acts.approving.carry_out_waiting()
    assert acts.outcome(outcome.id).state == "done"
