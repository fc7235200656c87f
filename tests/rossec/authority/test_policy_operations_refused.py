"""Grants of a policy that the master refuses."""

import pytest

from grants import document
from rossec.authority.policyfile import read_policy
from rossec.errors import NotDelivered
from tests.rossec.authority.test_policy_operations import CHANGED, POLICY, Office, office

__all__ = ["office"]


def test_a_grant_that_the_master_refuses_is_reported(office: Office) -> None:
    office.write(POLICY.replace('"*"', "/there").replace("/here", "/there"))
    office.answer = lambda _: "too many"
    said: list[str] = []
    plan = office.service.policy.plan(read_policy(office.root, None))
    with pytest.raises(NotDelivered, match="2 grants are signed, but not delivered") as caught:
        office.service.policy.apply(plan, said.append)
    assert "rossec grant deliver" in caught.value.hint
    assert said == [
        "signed: 2",
        "the master refuses a grant of /there: too many",
        "the master refuses a grant of /there: too many",
    ]
    office.known.clear()
    with pytest.raises(NotDelivered):
        office.service.policy.complete()
    office.answer = lambda _: ""
    office.service.policy.complete()


def test_what_the_master_had_no_room_for_is_deposited_after_the_revocation(office: Office) -> None:
    office.apply()
    office.write(CHANGED)

    def full(data: bytes) -> str:
        if "rossec.updateRevocations" in office.calls:
            return ""
        office.known.discard(document.grant_id(data))
        return "no room"

    office.answer = full
    said = office.apply()
    assert said == ["signed: 2", "revoked: 2 (list 2)", "the master has the new list"]
    assert office.calls[-2:] == ["rossec.deliveryStates", "rossec.depositGrants"]
