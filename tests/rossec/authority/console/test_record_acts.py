"""Approving what needs no key: another phone, a join code, the end of the master."""

from pathlib import Path

import pytest

from ca.enrollment.invitation import parse
from ca.errors import ApprovalRefused, HintedError, PatternRefused
from rossec.authority.console.access import PROPOSAL_LIFETIME
from rossec.authority.console.approved_acts import CODES_KEPT, MAX_CODES
from rossec.authority.console.messages import Proposal
from rossec.errors import ConfigurationError, KeyServiceRefused
from rossec.ros.names import MASTER
from tests.support import refusal_texts
from tests.support.approving import registered
from tests.support.consoleacts import DAY, JOIN_ADDRESS, Acts
from tests.support.passkeys import Passkey

KITCHEN = f"{MASTER}/kitchen"


@pytest.fixture
def acts(tmp_path: Path) -> Acts:
    acts = Acts(tmp_path / "home")
    acts.lock()  # none of these needs the key
    return acts


def propose(acts: Acts, device: Passkey, name: str = "Ben's phone") -> Proposal:
    return acts.access.proposed.add(registered(device, name, acts.now), acts.now)


def test_a_second_phone_is_added_by_the_first(acts: Acts) -> None:
    device = Passkey()
    proposal = propose(acts, device)
    outcome = acts.approve("passkey", proposal.id)
    assert (outcome.state, outcome.result) == ("done", "Ben's phone can approve")
    assert not acts.access.proposed.all()
    with acts.store() as store:
        added = store.passkeys.get(device.id)
    assert added.approval == outcome.id
    prepared = acts.asks("/lamp")
    assert acts.touch(prepared, device).state == "waiting"
    acts.audit_record()


def test_another_proposal_than_the_approved_one_is_not_added(acts: Acts) -> None:
    prepared = acts.prepare("passkey", propose(acts, Passkey()).id)
    acts.elapsed += PROPOSAL_LIFETIME - 1
    propose(acts, Passkey(), "Eve's phone")
    acts.elapsed += 1
    with pytest.raises(HintedError):
        acts.touch(prepared)
    with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
        acts.prepare("passkey", bytes(16))
    with acts.store() as store:
        assert [each.name for each in store.passkeys.all()] == ["Ann's phone"]


def test_a_proposal_that_ended_before_its_touch_is_not_added(acts: Acts) -> None:
    proposal = propose(acts, Passkey())
    prepared = acts.prepare("passkey", proposal.id)
    acts.access.proposed.drop(proposal.id)
    with pytest.raises(ApprovalRefused, match="does not wait any more"):
        acts.touch(prepared)


def test_a_phone_of_another_page_than_the_others_is_not_added(acts: Acts) -> None:
    """It was proposed before all phones were removed and the console got another name."""
    other = registered(Passkey(), "Eve's phone", acts.now)._replace(origin="https://eve.example")
    proposal = acts.access.proposed.add(other, acts.now)
    with pytest.raises(ApprovalRefused, match=refusal_texts.OTHER_ORIGIN):
        acts.approve("passkey", proposal.id)
    with acts.store() as store:
        assert [each.name for each in store.passkeys.all()] == ["Ann's phone"]


def test_a_name_that_is_taken_is_refused_when_it_is_shown(acts: Acts) -> None:
    with pytest.raises(HintedError, match="there is a passkey called"):
        acts.prepare("passkey", propose(acts, Passkey(), "Ann's phone").id)


def test_a_join_code_is_made_once_and_shown_for_some_minutes(acts: Acts) -> None:
    outcome = acts.approve("invitation", "/lamps/*", 3, 3600, True)
    code = parse(outcome.data.decode())
    assert (code.pattern, code.address, code.wildcard) == ("/lamps/*", JOIN_ADDRESS, True)
    assert code.expires == acts.now + 3600
    with acts.store() as store:
        row = store.invitations.check_open(code.id, acts.now)
    assert row.uses == 3
    assert outcome.result == f"join code {code.id.hex()[:8]}"
    assert acts.outcome(outcome.id).data == outcome.data
    assert outcome.data.decode() not in "".join(acts.audit)
    acts.elapsed += CODES_KEPT + 1
    assert acts.outcome(outcome.id).data == b""


def test_codes_that_can_be_shown_are_few(acts: Acts) -> None:
    first = acts.approve("invitation", "/a/*", 1, 60, False)
    later = [acts.approve("invitation", "/a/*", 1, 60, False) for _ in range(MAX_CODES)]
    assert acts.outcome(first.id).data == b""
    assert all(acts.outcome(each.id).data for each in later)


@pytest.mark.parametrize(
    ("given", "refusal"),
    [
        (("/x/*", 0, 3600, False), KeyServiceRefused),
        (("/x/*", 10_001, 3600, False), KeyServiceRefused),
        (("/x/*", 1, 59, False), KeyServiceRefused),
        (("/x/*", 1, 31 * DAY, False), KeyServiceRefused),
        (("no pattern", 1, 60, False), PatternRefused),
        ((MASTER, 1, 60, False), ConfigurationError),
    ],
)
def test_a_join_code_that_cannot_be_is_refused(
    acts: Acts, given: tuple[str, int, int, bool], refusal: type[Exception]
) -> None:
    with pytest.raises(refusal):
        acts.prepare("invitation", *given)


def test_the_master_is_revoked_at_once_and_listed_at_unlock(acts: Acts) -> None:
    acts.unlock()
    acts.enroll_master()
    acts.lock()
    outcome = acts.approve("revoke-master", " stolen ", MASTER)
    assert (outcome.state, outcome.result, outcome.data) == ("done", "/master is revoked", b"")
    assert acts.home.count_unlisted(acts.now) == 1
    with acts.store() as store:
        assert [row.reason for row in store.revocations()] == ["stolen"]
        assert not store.unrevoked_keys(MASTER, acts.now)
    acts.unlock()
    acts.work.maintain()
    assert acts.home.count_unlisted(acts.now) == 0
    with pytest.raises(ConfigurationError, match="no valid identity"):
        acts.prepare("revoke-master", "again", MASTER)


def test_another_master_is_revoked_alone(acts: Acts) -> None:
    acts.unlock()
    for name in (MASTER, KITCHEN):
        assert acts.enroll(name).state == "done"
    outcome = acts.approve("revoke-master", "sold", KITCHEN)
    assert outcome.result == "/master/kitchen is revoked"
    with acts.store() as store:
        assert store.unrevoked_keys(MASTER, acts.now)
        assert not store.unrevoked_keys(KITCHEN, acts.now)
    for other in ("/robot", f"{KITCHEN}/x", 7):
        with pytest.raises(KeyServiceRefused, match="arguments"):
            acts.prepare("revoke-master", "x", other)


def test_an_intermediate_revokes_no_master(acts: Acts) -> None:
    (acts.home.path / "intermediate.pem").write_bytes((acts.home.path / "ca.pem").read_bytes())
    with pytest.raises(ConfigurationError, match="an intermediate cannot revoke"):
        acts.prepare("revoke-master", "x", MASTER)


@pytest.mark.parametrize("kind", ["passkey", "invitation", "revoke-master"])
def test_wrong_arguments_are_refused(acts: Acts, kind: str) -> None:
    with pytest.raises(KeyServiceRefused, match="arguments"):
        acts.prepare(kind, 1)
