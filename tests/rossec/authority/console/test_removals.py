"""Taking away: at once, without a passkey, and also while the key is locked."""

import secrets
from pathlib import Path

import pytest

from ca.errors import ApprovalRefused, HintedError, JoinRefused, StoreError
from ca.revocation.lists import RevocationList
from ca.revocation.trust_status import open_statement
from rossec.authority.console.grant_requests import MAX_REASON, UNSIGNED
from rossec.authority.console.serving import handlers_of
from rossec.authority.invitations import invite, source
from rossec.authority.requests import GrantRequestStore
from rossec.errors import ConfigurationError, KeyServiceRefused
from rossec.ros.names import MASTER
from tests.support import refusal_texts
from tests.support.consoleacts import DAY, Acts


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    return Acts(tmp_path / "home")


def listed(acts: Acts) -> RevocationList:
    found = open_statement(acts.home.revocation_list(), acts.home.own_key())
    assert isinstance(found, RevocationList)
    return found


def test_a_grant_is_revoked_and_the_master_is_told(acts: Acts) -> None:
    acts.enroll("/fleet/a")
    with acts.store() as store:
        (row,) = store.grants()
    woken = acts.woken
    number = acts.removals.revoke_grant(row.id, "moved out")
    assert number == [*listed(acts).number]
    assert row.id in listed(acts).entries
    assert acts.woken == woken + 1
    assert acts.audit[-1].endswith("for a revocation at the console")
    acts.work.maintain()
    assert acts.calls[0].method == "rossec.updateRevocations"


def test_a_revocation_while_locked_is_recorded_and_listed_at_unlock(acts: Acts) -> None:
    acts.enroll("/fleet/a")
    before = listed(acts).number
    acts.lock()
    assert acts.removals.revoke_node("/fleet/a", "lost") == [*UNSIGNED]
    assert listed(acts).number == before
    with acts.store() as store:
        assert not store.identities.valid("/fleet/a", acts.now)
    acts.unlock()
    acts.work.maintain()
    assert listed(acts).number > before
    assert acts.home.count_unlisted(acts.now) == 0
    acts.audit_record()


def test_a_key_that_is_dropped_in_the_middle_leaves_it_recorded(acts: Acts) -> None:
    acts.enroll("/lamp")
    acts.before_audit = acts.lock
    assert acts.removals.revoke_node("/lamp", "lost") == [*UNSIGNED]
    with acts.store() as store:
        assert not store.unrevoked_keys("/lamp", acts.now)


def test_some_nodes_are_not_revoked_here(acts: Acts) -> None:
    acts.enroll_master()
    with pytest.raises(KeyServiceRefused, match="own node"):
        acts.removals.revoke_node("/ca", "x")
    for master in (MASTER, f"{MASTER}/kitchen"):
        with pytest.raises(KeyServiceRefused, match="a phone has to approve"):
            acts.removals.revoke_node(master, "x")
    with pytest.raises(ConfigurationError, match="no valid identity"):
        acts.removals.revoke_node("/nobody", "x")
    with pytest.raises(HintedError):
        acts.removals.revoke_node("no name", "x")
    with pytest.raises(StoreError, match="no such grant"):
        acts.removals.revoke_grant(bytes(16), "x")


def test_an_intermediate_revokes_nothing(acts: Acts) -> None:
    (acts.home.path / "intermediate.pem").write_bytes((acts.home.path / "ca.pem").read_bytes())
    with pytest.raises(ConfigurationError, match="an intermediate cannot revoke"):
        acts.removals.revoke_node("/lamp", "x")


def test_requests_are_denied_once(acts: Acts) -> None:
    acts.asks("/lamp")
    with acts.store() as store:
        (row,) = store.requests.open()
    acts.removals.deny_request(row.digest, " not mine ")
    with acts.store() as store:
        assert store.requests.get(row.digest).reason == "not mine"
    for digest in (row.digest, bytes(32)):
        with pytest.raises(StoreError, match=r"(is denied and cannot be|there is no such request)"):
            acts.removals.deny_request(digest, "")


def test_questions_are_denied_with_every_right(acts: Acts) -> None:
    question = acts.ask("/map", "/pose", "/odom")
    acts.removals.deny_question(question, "")
    with acts.store() as store:
        assert not GrantRequestStore(store.database).unanswered()
        rows = store.database.rows("SELECT answer, reason FROM decision")
    assert rows == [("denied", "a person")] * 2


def test_an_ended_join_code_takes_with_it_what_waits_because_of_it(acts: Acts) -> None:
    code = invite(acts.home, "/fleet/*", 3, acts.now + DAY, "127.0.0.1:9", acts.now)
    with acts.store() as store:
        origin = source(store.invitations.get(code.id))
    acts.lock()
    waits = acts.touch(acts.prepare("enroll", acts.csr("/fleet/b"), origin, False, DAY, False))
    other = acts.enroll("/lamp")
    acts.removals.end_invitation(code.id, "over")
    assert acts.outcome(waits.id).result == "denied: its join code was ended: over"
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(other.id).state == "done"
    with acts.store() as store:
        assert not store.identities.by_name("/fleet/b")
        assert store.invitations.ended(code.id) == "over"
    with pytest.raises(JoinRefused, match="no such invitation"):
        acts.removals.end_invitation(secrets.token_bytes(32), "")


def test_a_phone_is_removed_once(acts: Acts) -> None:
    acts.removals.remove_phone(acts.phone.id, "lost")
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        acts.removals.remove_phone(acts.phone.id, "lost")


def test_a_reason_is_bounded(acts: Acts) -> None:
    with pytest.raises(KeyServiceRefused, match="a reason of 257 characters"):
        acts.removals.remove_phone(acts.phone.id, "x" * (MAX_REASON + 1))


def test_each_operation_that_takes_away_has_a_handler(acts: Acts) -> None:
    assert sorted(handlers_of(acts.removals)) == [
        "deny-question",
        "deny-request",
        "end-invitation",
        "remove-phone",
        "revoke-grant",
        "revoke-node",
    ]
