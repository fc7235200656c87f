"""Approving by others: what a stolen session, a hostile page or a copied phone can get approved."""

import shutil
import threading
from pathlib import Path
from typing import Any

import pytest

from ca.errors import ApprovalRefused, HintedError, StoreError
from grants import document
from rossec.authority.backup import back_up, restore
from rossec.authority.console.grant_requests import Questions
from rossec.authority.console.messages import ApprovalOutcome, GrantQuestion, Prepared
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.process import operations_of
from rossec.authority.requests import GrantRequestStore
from rossec.errors import KeyServiceRefused
from rossec.ros.names import MASTER
from tests.support import refusal_texts
from tests.support.consoleacts import DAY, SECRET, Acts
from tests.support.consolework import many
from tests.support.passkeys import UP, Assertion, Passkey

PROMPTED = "prompt: {subscribe: [/pose, /odom]}"


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    return Acts(tmp_path / "home")


def sent(acts: Acts, prepared: Prepared, signed: Assertion) -> None:
    """What a page sends, which may be anything."""
    acts.approving.approve(prepared.id, *signed)


def nothing_was_given(acts: Acts, name: str = "/lamp") -> None:
    with acts.store() as store:
        assert not store.approvals.all()
        assert not store.identities.by_name(name)
        assert not store.grants()
    assert not any("signs" in line for line in acts.audit)
    acts.audit_record()


@pytest.mark.attack("console-longer")
def test_a_form_of_ones_own_approves_for_no_longer_than_the_policy_allows(acts: Acts) -> None:
    """The page's button for a month is disabled, where the policy allows seven days."""
    question = acts.ask("/map")
    for seconds in (7 * DAY + 1, 30 * DAY):
        with pytest.raises(KeyServiceRefused, match="allows this for 7d at most"):
            acts.prepare("grant", question, "", seconds)
    acts.touch(acts.prepare("grant", question, "", 7 * DAY))
    with acts.store() as store:
        (row,) = store.grants()
    assert document.peek(row.data).cap == acts.now + 7 * DAY


@pytest.mark.attack("console-more-rights")
def test_a_touch_for_one_right_gives_no_other_of_the_same_request(acts: Acts) -> None:
    """Whoever lets a node see a camera has not let it drive."""
    policy = acts.home.path / "policy.yaml"
    policy.write_text(policy.read_text().replace("prompt: {subscribe: [/pose]}", PROMPTED))
    acts.ask("/map", "/pose", "/odom")
    asked = many(GrantQuestion, Questions(acts.work).questions())
    assert [len(each.rights) for each in asked] == [1, 1]
    (pose,) = [each for each in asked if each.rights[0].pattern == "/pose"]
    acts.touch(acts.prepare("grant", pose.id, "", 0))
    with acts.store() as store:
        (row,) = store.grants()
        (left,) = GrantRequestStore(store.database).unanswered()
    assert [each.pattern for each in document.peek(row.data).permissions] == ["/pose"]
    assert left.requested.pattern == "/odom"


@pytest.mark.attack("console-other-statement")
def test_a_touch_for_one_statement_approves_no_other(acts: Acts) -> None:
    shown, other = acts.asks("/lamp"), acts.asks("/thief")
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        sent(acts, other, acts.phone.sign(shown.challenge))
    nothing_was_given(acts, "/thief")


@pytest.mark.attack("console-other-statement")
def test_a_login_is_no_approval(acts: Acts) -> None:
    prepared = acts.asks()
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_CHALLENGE):
        sent(acts, prepared, acts.phone.sign(prepared.challenge, kind="webauthn.create"))
    nothing_was_given(acts)


@pytest.mark.attack("console-swapped-request")
def test_a_request_that_was_swapped_after_it_was_shown_is_not_signed(acts: Acts) -> None:
    shown = acts.csr("/lamp")
    prepared = acts.asks(csr=shown)
    swapped = acts.csr("/lamp")
    with pytest.raises(HintedError, match="two different keys request the name"):
        acts.asks(csr=swapped)
    with pytest.raises(HintedError, match="two different keys"):  # of which a person rejects one
        acts.touch(prepared)
    nothing_was_given(acts)


@pytest.mark.attack("console-replayed-approval")
def test_an_assertion_is_used_once(acts: Acts) -> None:
    prepared = acts.asks()
    signed = acts.phone.sign(prepared.challenge)
    sent(acts, prepared, signed)
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        sent(acts, prepared, signed)
    again = acts.asks("/other")
    with pytest.raises(ApprovalRefused):
        sent(acts, again, signed)
    acts.start()  # nor by a service that was restarted
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        sent(acts, prepared, signed)
    with acts.store() as store:
        assert len(store.approvals.all()) == 1


@pytest.mark.attack("console-replayed-approval")
def test_a_passkey_without_a_counter_cannot_be_replayed_either(acts: Acts) -> None:
    acts.phone.counts = False
    prepared = acts.asks()
    signed = acts.phone.sign(prepared.challenge)
    sent(acts, prepared, signed)
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        sent(acts, prepared, signed)


@pytest.mark.attack("console-cloned-passkey")
def test_a_copy_of_a_phone_is_noticed_by_its_counter(acts: Acts) -> None:
    copy = acts.phone.clone()
    assert acts.enroll("/lamp").state == "done"
    prepared = acts.asks("/thief")
    with pytest.raises(ApprovalRefused, match="counter"):
        acts.touch(prepared, copy)
    with acts.store() as store:
        assert not store.identities.by_name("/thief")


@pytest.mark.attack("console-other-origin")
@pytest.mark.parametrize(
    ("flaw", "refusal"),
    [
        ({"origin": "https://evil.example"}, refusal_texts.OTHER_ORIGIN),
        ({"rp_id": "evil.example"}, refusal_texts.OTHER_ORIGIN),
        ({"cross_origin": True}, refusal_texts.OTHER_ORIGIN),
        ({"flags": UP}, refusal_texts.NOT_VERIFIED),
        ({"flags": 0}, refusal_texts.NOT_VERIFIED),
    ],
    ids=str,
)
def test_a_touch_at_another_page_or_without_its_owner_is_refused(
    acts: Acts, flaw: dict[str, Any], refusal: str
) -> None:
    with pytest.raises(ApprovalRefused, match=refusal):
        acts.touch(acts.asks(), **flaw)
    nothing_was_given(acts)


@pytest.mark.attack("console-other-origin")
def test_another_key_with_the_name_of_a_phone_approves_nothing(acts: Acts) -> None:
    thief = Passkey()
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        acts.touch(acts.asks("/lamp"), thief)
    thief.id = acts.phone.id
    with pytest.raises(ApprovalRefused, match=refusal_texts.ASSERTION_FORGED):
        acts.touch(acts.asks("/lamp2"), thief)
    nothing_was_given(acts)


@pytest.mark.attack("console-two-approve")
def test_of_two_browsers_that_approve_one_request_one_is_refused(acts: Acts) -> None:
    acts.lock()  # so that both only record
    csr = acts.csr()
    touches = [
        (prepared, acts.phone.sign(prepared.challenge))
        for prepared in (acts.asks(csr=csr), acts.asks(csr=csr))
    ]
    results: list[object] = []
    together = threading.Barrier(2)

    def approve(prepared: Prepared, signed: Assertion) -> None:
        together.wait(10)
        try:
            results.append(acts.approving.approve(prepared.id, *signed))
        except (StoreError, ApprovalRefused) as error:
            results.append(error)

    threads = [threading.Thread(target=approve, args=each) for each in touches]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert sum(isinstance(each, HintedError) for each in results) == 1, results
    with acts.store() as store:
        assert len(store.approvals.all()) == 1


@pytest.mark.attack("console-old-approval")
def test_an_approval_from_before_a_restore_is_not_carried_out(acts: Acts, tmp_path: Path) -> None:
    acts.lock()
    waits = acts.enroll("/lamp")
    held = acts.asks("/held")
    signed = acts.phone.sign(held.challenge)
    backup = back_up(acts.home, SECRET)
    shutil.rmtree(acts.home.path)
    restore(acts.root, backup, SECRET, acts.now)
    acts.home = AuthorityHome.at(acts.root)
    with pytest.raises(ApprovalRefused):  # by the process that still has the statement
        sent(acts, held, signed)
    acts.operations = operations_of(acts.home, acts.write_audit)
    acts.start()
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).state == "failed"
    with acts.store() as store:
        assert not store.identities.by_name("/lamp")
        assert not store.passkeys.active(), "one of them may have been removed since"


@pytest.mark.attack("console-stopped-clock")
@pytest.mark.parametrize("shift", [0, -3600, -1], ids=["stopped", "an hour back", "a second back"])
def test_a_clock_that_does_not_go_on_makes_no_statement_last(acts: Acts, shift: int) -> None:
    prepared = acts.asks()
    acts.elapsed += 301
    acts.now += shift
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        acts.touch(prepared)
    nothing_was_given(acts)


@pytest.mark.attack("console-stopped-clock")
def test_a_clock_that_is_set_back_approves_nothing_from_its_future(acts: Acts) -> None:
    prepared = acts.asks()
    acts.now -= 1
    with pytest.raises(ApprovalRefused, match=refusal_texts.APPROVAL_OUTDATED):
        acts.touch(prepared)
    nothing_was_given(acts)


@pytest.mark.attack("console-stopped-clock")
def test_a_stopped_clock_makes_nothing_wait_for_ever(acts: Acts) -> None:
    acts.lock()
    waits = acts.enroll("/lamp")
    acts.elapsed += DAY + 301
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id).state == "expired"


@pytest.mark.attack("console-removed-phone")
def test_a_phone_that_was_removed_approves_nothing_not_even_what_waits(acts: Acts) -> None:
    acts.lock()
    waits = acts.enroll("/lamp")
    other = acts.asks("/other")
    signed = acts.phone.sign(other.challenge)
    acts.removals.remove_phone(acts.phone.id, "stolen")
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        sent(acts, other, signed)
    acts.unlock()
    acts.approving.carry_out_waiting()
    assert acts.outcome(waits.id) == ApprovalOutcome(waits.id, "failed", "its phone was removed: stolen", b"")
    with acts.store() as store:
        assert not store.identities.by_name("/lamp")


@pytest.mark.attack("console-denied-meanwhile")
@pytest.mark.parametrize("is_approved", [False, True])
def test_a_request_that_was_denied_meanwhile_is_not_issued(acts: Acts, is_approved: bool) -> None:
    acts.lock()
    prepared = acts.asks("/lamp")
    with acts.store() as store:
        (row,) = store.requests.open()
    if is_approved:
        waits = acts.touch(prepared)
        acts.removals.deny_request(row.digest, "not mine")
        assert acts.outcome(waits.id).result == "denied: not mine"
    else:
        acts.removals.deny_request(row.digest, "not mine")
        with pytest.raises(StoreError, match="denied"):
            acts.touch(prepared)
    acts.unlock()
    acts.approving.carry_out_waiting()
    with acts.store() as store:
        assert not store.identities.by_name("/lamp")


@pytest.mark.attack("stolen-console-session")
def test_a_session_alone_takes_away_and_gives_nothing(acts: Acts) -> None:
    """Every operation that a session has, without a phone in the thief's hand."""
    acts.enroll("/lamp")
    acts.enroll_master()
    with acts.store() as store:
        before = len(store.identities.all()), len(store.passkeys.active())
    assert acts.removals.revoke_node("/lamp", "thief") != [0, 0]
    for master in (MASTER, f"{MASTER}/kitchen"):
        with pytest.raises(KeyServiceRefused, match="a phone has to approve"):
            acts.removals.revoke_node(master, "thief")
    for kind, *arguments in (
        ("invitation", "/thief/*", 10, 3600, True),
        ("delegate", 86400, 3600),
        ("revoke-master", "thief", MASTER),
    ):
        prepared = acts.prepare(str(kind), *arguments)
        with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
            acts.touch(prepared, Passkey())
        with pytest.raises(HintedError):
            acts.approving.approve(prepared.id, acts.phone.id, b"{}", b"", b"")
    with acts.store() as store:
        assert (len(store.identities.all()), len(store.passkeys.active())) == before
        assert not store.invitations.all()
        assert store.valid_certificate(MASTER, acts.now)
        assert not GrantRequestStore(store.database).unanswered()
