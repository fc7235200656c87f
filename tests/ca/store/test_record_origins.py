"""Where a grant in the record came from: the policy, or a person."""

from pathlib import Path

from ca.store.record import GrantRow, Store
from tests.support.pki import new_signer

NOW = 1_800_000_000


def test_grants_from_the_policy_are_told_from_those_by_hand(tmp_path: Path) -> None:
    store, by_hand = Store.create(tmp_path / "ca.db"), GrantRow(b"h" * 16, "/a", b"", NOW, NOW + 9)
    store.add_grant(by_hand, NOW)
    by_policy = by_hand._replace(id=b"p" * 16)
    store.add_grant(by_policy, NOW, "pose, night")
    assert store.policy_grants() == {by_policy.id: "pose, night"}
    assert store.policy_grants([by_policy.name, "/other"]) == store.policy_grants()
    assert store.policy_grants(["/other"]) == {}
    assert store.grants() == [by_hand, by_policy]
    assert [e.detail for e in store.log.entries() if e.what == "policy grant"] == ["pose, night"]
    store.log.audit(new_signer().public_key)
    store.close()
