import hashlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.approvals.statement import StatementKind
from ca.errors import ApprovalOver, ApprovalRefused, StoreError
from ca.store.log import RESTORED, ApprovalEnd, ApprovalState
from ca.store.record import Store
from tests.support import passkeys, refusal_texts
from tests.support.approving import NOW, WHATS, approve, registered, state, touch
from tests.support.pki import new_signer


@pytest.fixture
def device() -> passkeys.Passkey:
    return passkeys.Passkey()


@pytest.fixture
def store(tmp_path: Path, device: passkeys.Passkey) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as store:
        store.passkeys.add(registered(device))
        yield store


def audited(store: Store) -> None:
    store.log.audit(new_signer().public_key)


def test_an_approval_is_recorded_as_given_and_waits(store: Store, device: passkeys.Passkey) -> None:
    approval = approve(store, device=device)
    statement = store.approvals.add(approval)
    assert (statement.kind, statement.what) == (StatementKind.DELEGATE, WHATS[StatementKind.DELEGATE])
    assert store.approvals.get(approval.id) == approval
    assert store.approvals.all() == store.approvals.newest(5) == store.approvals.waiting()
    assert store.approvals.state(approval.id) is ApprovalState.WAITING
    assert store.approvals.about(StatementKind.DELEGATE, statement.subject) == [approval]
    assert store.approvals.about(StatementKind.GRANT, statement.subject) == []
    assert store.log.entries()[-1][2:5] == ("approval", "Ann's phone", f"delegate {approval.id.hex()}")
    audited(store)


def test_a_statement_is_approved_once(store: Store, device: passkeys.Passkey) -> None:
    statement = state(WHATS[StatementKind.DELEGATE], store=store)
    first = touch(statement, device=device)
    store.approvals.add(first)
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_CLONED):  # the same assertion
        store.approvals.add(first)
    with pytest.raises(ApprovalRefused, match="approved already"):
        store.approvals.add(touch(statement, device=device))


def test_a_passkey_that_does_not_count_approves_a_statement_once(store: Store) -> None:
    synced = passkeys.Passkey(counts=False)
    store.passkeys.add(registered(synced, "synced"))
    approval = approve(store, device=synced)
    store.approvals.add(approval)
    assert store.approvals.counter(synced.id) == 0
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_USED):
        store.approvals.add(approval)
    store.approvals.add(approve(store, id=b"j" * 16, device=synced))
    audited(store)


def test_the_counter_is_that_of_the_newest_assertion(store: Store, device: passkeys.Passkey) -> None:
    assert store.approvals.counter(device.id) == 0
    clone = device.clone()
    store.approvals.add(approve(store, device=device))
    assert store.approvals.counter(device.id) == 1
    with pytest.raises(ApprovalRefused, match="is 1 and was 1"):
        store.approvals.add(approve(store, id=b"c" * 16, device=clone))
    with pytest.raises(ApprovalRefused, match="is 2 and was 7"):  # as a login said
        store.approvals.add(approve(store, id=b"d" * 16, device=device), counter=7)
    assert len(store.approvals.all()) == 1


def test_only_a_registered_passkey_approves(store: Store, device: passkeys.Passkey) -> None:
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        store.approvals.add(approve(store, device=passkeys.Passkey()))
    stolen = passkeys.Passkey()
    stolen.id = device.id
    with pytest.raises(ApprovalRefused, match=refusal_texts.ASSERTION_FORGED):
        store.approvals.add(approve(store, device=stolen))
    late = approve(store, device=device)
    store.passkeys.end(device.id, "lost", NOW)
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        store.approvals.add(late)
    assert store.approvals.all() == []


@pytest.mark.parametrize("at", [NOW - 1, NOW + 301])
def test_an_approval_comes_in_time(store: Store, device: passkeys.Passkey, at: int) -> None:
    approval = approve(store, device=device)._replace(at=at)
    with pytest.raises(ApprovalRefused, match="in time"):
        store.approvals.add(approval)


def test_a_payload_is_the_approved_one(store: Store, device: passkeys.Passkey) -> None:
    what = WHATS[StatementKind.GRANT]._replace(payload=hashlib.sha256(b"claims").digest())  # type: ignore[call-arg]  # a Grant
    with pytest.raises(ApprovalRefused, match="not what was shown"):
        store.approvals.add(approve(store, what, b"other claims", device=device))
    approval = approve(store, what, b"claims", device=device)
    store.approvals.add(approval)
    assert store.approvals.get(approval.id).payload == b"claims"


def test_an_approval_is_about_this_record(store: Store, device: passkeys.Passkey, tmp_path: Path) -> None:
    with closing(Store.create(tmp_path / "other.db")) as other:
        other.log_event("elsewhere", "", "", NOW)
        with pytest.raises(ApprovalRefused, match="restored or replaced"):
            store.approvals.add(approve(other, device=device))
    later = state(WHATS[StatementKind.DELEGATE], store=store)._replace(log_size=99)
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        store.approvals.add(touch(later, device=device))
    store.approvals.add(touch(state(WHATS[StatementKind.DELEGATE], store=store), device=device))


def test_an_approval_from_before_a_restore_is_refused(store: Store, device: passkeys.Passkey) -> None:
    before = approve(store, device=device)
    store.log_event(RESTORED, "record", "", NOW)
    with pytest.raises(ApprovalRefused, match="restored or replaced"):
        store.approvals.add(before)
    store.approvals.add(approve(store, device=device))
    audited(store)


def test_an_approval_ends_once(store: Store, device: passkeys.Passkey) -> None:
    approval = approve(store, device=device)
    store.approvals.add(approval)
    store.approvals.end(approval.id, ApprovalState.DONE, "list 1.2", NOW + 1)
    assert store.approvals.state(approval.id) is ApprovalState.DONE
    assert store.approvals.ends() == {approval.id: ApprovalEnd(approval.id, "done", "list 1.2", NOW + 1)}
    assert store.approvals.waiting() == []
    with pytest.raises(ApprovalOver, match="this approval has ended: done"):
        store.approvals.end(approval.id, ApprovalState.FAILED, "", NOW)
    audited(store)


def test_an_unknown_approval_is_refused(store: Store) -> None:
    for call in (
        lambda: store.approvals.get(b"x" * 16),
        lambda: store.approvals.state(b"x" * 16),
        lambda: store.approvals.end(b"x" * 16, ApprovalState.DONE, "", NOW),
    ):
        with pytest.raises(ApprovalOver, match="no such approval"):
            call()


def test_waiting_is_not_an_end(store: Store, device: passkeys.Passkey) -> None:
    approval = approve(store, device=device)
    store.approvals.add(approval)
    with pytest.raises(ValueError, match="not an end"):
        store.approvals.end(approval.id, ApprovalState.WAITING, "", NOW)


def test_everything_that_waits_is_ended(store: Store, device: passkeys.Passkey) -> None:
    done, waits = (approve(store, id=id_ * 16, device=device) for id_ in (b"1", b"2"))
    for approval in (done, waits):
        store.approvals.add(approval)
    store.approvals.end(done.id, ApprovalState.DONE, "", NOW)
    assert store.approvals.end_waiting("restored", NOW) == 1
    assert store.approvals.state(done.id) is ApprovalState.DONE
    assert store.approvals.state(waits.id) is ApprovalState.FAILED


def test_removing_a_passkey_ends_what_waits_by_it(store: Store, device: passkeys.Passkey) -> None:
    other = passkeys.Passkey()
    store.passkeys.add(registered(other, "Bob's phone"))
    mine, theirs = approve(store, device=device), approve(store, id=b"o" * 16, device=other)
    for approval in (mine, theirs):
        store.approvals.add(approval)
    store.remove_passkey(device.id, "stolen", NOW)
    assert store.approvals.ends()[mine.id].result == "its phone was removed: stolen"
    assert store.approvals.waiting() == [theirs]
    audited(store)


def test_an_approval_whose_act_fails_is_not_used(store: Store, device: passkeys.Passkey) -> None:
    approval = approve(store, device=device)

    def carry_out() -> None:
        with store.transaction():
            store.approvals.add(approval)
            raise StoreError("no grant")

    with pytest.raises(StoreError):
        carry_out()
    store.approvals.add(approval)
    assert store.approvals.all() == [approval]
