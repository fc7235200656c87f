"""What acts have in common: a try that changes nothing, and a name for the record."""

from pathlib import Path

import pytest

from rossec.authority.console.approved_acts import RevokeMasterAct
from rossec.authority.console.approving import Approved, tried
from tests.support.consoleacts import Acts


def test_a_try_changes_nothing_and_shows_a_refusal(tmp_path: Path) -> None:
    acts = Acts(tmp_path / "home")
    with acts.store() as store:
        before = store.log.head(acts.now)
        with tried(store):
            store.revoke(b"x" * 16, "a try", acts.now)
            assert b"x" * 16 in store.revoked_entries()
        assert not store.revoked_entries()
        with pytest.raises(ZeroDivisionError), tried(store):
            store.revoke(b"x" * 16, str(1 // 0), acts.now)
        assert store.log.head(acts.now) == before


def test_an_approval_is_named_by_the_beginning_of_its_id(tmp_path: Path) -> None:
    acts = Acts(tmp_path / "home")
    outcome = acts.approve("invitation", "/a/*", 1, 60, False)
    with acts.store() as store:
        approval = store.approvals.get(outcome.id)
    approved = Approved(approval)
    assert approved.id == outcome.id
    assert approved.reason == f"approval {outcome.id.hex()[:8]}"
    with acts.work.service("a test") as service:
        assert RevokeMasterAct().made(service, approved) == b""
        with pytest.raises(AssertionError):
            RevokeMasterAct().carry_out(service, approved, acts.now)
