"""Approving identities: the request that was shown, for a name that is free, and intermediates."""

from pathlib import Path

import pytest

from ca.authority import MAX_LIFETIME
from ca.certificates import build_intermediate_request, from_pem
from ca.errors import HintedError, RequestRefused, StoreError
from ca.svid import build_request
from rossec.errors import KeyServiceRefused
from tests.support import refusal_texts
from tests.support.consoleacts import DAY, Acts
from tests.support.pki import new_signer


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    return Acts(tmp_path / "home")


def keys(acts: Acts, name: str) -> int:
    with acts.store() as store:
        return len(store.unrevoked_keys(name, acts.now))


def test_a_node_gets_its_identity_and_what_the_policy_gives_it(acts: Acts) -> None:
    outcome = acts.enroll("/fleet/a")
    leaf, root = from_pem(outcome.data)
    found = acts.home.anchor().verify([leaf], acts.now)
    assert (found.name, root) == ("/fleet/a", acts.home.anchor().certificate)
    assert acts.grants("/fleet/a") == 1
    with acts.store() as store:
        *_, row = store.requests.all()
    assert (row.state, row.source) == ("issued", "code")


def test_preparing_records_the_request_and_no_more(acts: Acts) -> None:
    acts.asks("/lamp")
    with acts.store() as store:
        *_, row = store.requests.all()
        assert row.state == "pending"
        assert not store.approvals.all()


def test_a_lost_answer_is_given_again_for_the_same_request(acts: Acts) -> None:
    csr = acts.csr("/lamp")
    first, again = acts.enroll("/lamp", csr=csr), acts.enroll("/lamp", csr=csr)
    assert first.data == again.data
    acts.removals.revoke_node("/lamp", "lost")
    with pytest.raises(HintedError, match="revoked"):
        acts.asks("/lamp", csr=csr)


def test_another_key_needs_to_replace_the_one_there_is(acts: Acts) -> None:
    acts.enroll("/lamp")
    with pytest.raises(StoreError, match=refusal_texts.KEY_CHANGED):
        acts.asks("/lamp")
    with acts.store() as store:
        (row,) = store.requests.open()
    outcome = acts.enroll("/lamp", csr=row.der, replaces=True)
    assert outcome.state == "done"
    assert keys(acts, "/lamp") == 1
    assert acts.home.count_unlisted(acts.now) == 0, "the old key is on the list"


def test_anonymous_nodes_are_approved_as_such(acts: Acts) -> None:
    csr = build_request(new_signer(), "home", "/rviz", wildcard=True)
    with pytest.raises(RequestRefused, match="all names that begin"):
        acts.asks("/rviz", csr=csr)
    outcome = acts.enroll("/rviz", csr=csr, wildcard=True)
    assert acts.home.anchor().verify(from_pem(outcome.data)[:1], acts.now).wildcard


def test_what_was_approved_otherwise_meanwhile_fails(acts: Acts) -> None:
    acts.lock()
    prepared = acts.asks("/rviz")
    waits = acts.touch(prepared)
    with acts.store() as store, store.transaction() as db:  # as nothing of rossec does
        db.execute("DROP TRIGGER csr_moves")
        db.execute("UPDATE csr SET wildcard = 1")
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).result == "the request of /rviz was approved otherwise"


def test_a_request_that_expired_while_it_waited_fails(acts: Acts) -> None:
    acts.lock()
    waits = acts.enroll("/lamp")
    acts.pass_time(DAY + 1)
    with acts.store() as store:
        store.requests.collect(acts.now)
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).result == "the request of /lamp has expired"


def test_a_request_that_expired_before_the_touch_is_refused(acts: Acts) -> None:
    csr = acts.csr("/lamp")
    acts.asks("/lamp", csr=csr)
    acts.pass_time(DAY - 100)
    prepared = acts.asks("/lamp", csr=csr)
    acts.pass_time(200)
    with acts.store() as store:
        store.requests.collect(acts.now)
    with pytest.raises(StoreError, match="expired"):
        acts.touch(prepared)


@pytest.mark.parametrize("lifetime", [0, -1, MAX_LIFETIME + 1])
def test_lifetimes_are_bounded(acts: Acts, lifetime: int) -> None:
    with pytest.raises(KeyServiceRefused, match="lifetime"):
        acts.prepare("enroll", acts.csr(), "code", False, lifetime, False)
    csr = build_intermediate_request(new_signer(), "home")
    with pytest.raises(KeyServiceRefused, match="lifetime"):
        acts.prepare("intermediate", csr, False, lifetime)


def test_the_authoritys_own_node_and_wrong_arguments_are_refused(acts: Acts) -> None:
    with pytest.raises(KeyServiceRefused, match="own node"):
        acts.asks("/ca")
    for kind in ("enroll", "intermediate"):
        with pytest.raises(KeyServiceRefused, match="arguments"):
            acts.prepare(kind, 1)
    with pytest.raises(RequestRefused):
        acts.asks(csr=b"no request")


def test_where_a_request_came_from_is_cut(acts: Acts) -> None:
    acts.prepare("enroll", acts.csr(), "x" * 1000, False, DAY, False)
    with acts.store() as store:
        assert len(store.requests.all()[-1].source) <= 256


def test_an_intermediate_is_signed(acts: Acts) -> None:
    csr = build_intermediate_request(new_signer(), "home")
    prepared = acts.prepare("intermediate", csr, True, 30 * DAY)
    acts.lock()
    waits = acts.touch(prepared)
    assert waits.state == "waiting"
    acts.unlock()
    acts.approving.carry_out_waiting()
    done = acts.outcome(waits.id)
    assert done.result.startswith("signed intermediate/")
    made = acts.home.anchor().read_intermediate(from_pem(done.data)[0])
    assert made.may_enroll
    acts.removals.revoke_node(done.result.removeprefix("signed "), "stolen")
    with pytest.raises(HintedError, match="revoked"):
        acts.prepare("intermediate", csr, True, 30 * DAY)


def test_an_intermediate_makes_no_other(acts: Acts) -> None:
    (acts.home.path / "intermediate.pem").write_bytes((acts.home.path / "ca.pem").read_bytes())
    with pytest.raises(KeyServiceRefused, match="makes no other"):
        acts.prepare("intermediate", b"csr", False, DAY)
