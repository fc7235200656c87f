"""Values that nobody tried, sent through filters that a policy's tests call hiding or coarse."""

import math
import struct

import pytest

from grants.decision import Decision
from grants.errors import PolicyRefused
from grants.guard import Guard
from grants.model import Right
from grants.policy.assertion_check import require_tests
from grants.policy.decision import Decider
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import node, policy

POINT = "geometry_msgs/Point"
TEXT = """rossec: 1
robot: r
types: {{/at: geometry_msgs/Point}}
rules:
  - {{id: r, who: /spy, allow: {{subscribe: /at}}, filter: {{x: {rule}, y: {{clear: true}},
     z: {{clear: true}}}}{more}}}
tests:
  - {{who: /spy, sees: {{/at: {{x: {says}}}}}}}
"""
CASES = [
    ("{round: 5000}", "no", (0.0, 7000.0)),
    ("{round: 1.0e+300}", "no", (0.0, math.nan)),
    ("{clamp: [90000, 99999]}", "no", (0.0, 95000.0)),
    ("{clamp: [90000, 99999]}", "0.5", (95000.0, 95000.01)),
    ("{clamp: [-2000, -1999.5]}", "1.0", (-1999.9, -1999.8)),
]


@pytest.mark.attack("untried-values")
@pytest.mark.parametrize(("rule", "says", "values"), CASES)
def test_a_policy_that_says_more_than_the_guard_does_is_refused(
    rule: str, says: str, values: tuple[float, float]
) -> None:
    read = policy(TEXT.format(rule=rule, says=says, more=""))
    verdict = Decider(read).decide(node("/spy"), Right.SUBSCRIBE, "/at")
    decision = Decision(Right.SUBSCRIBE, "/at", (), 1 << 40, verdict.restrictions)
    guard = Guard(layout_of(POINT), decision)
    sent = [guard.apply(struct.pack("<3d", value, 0, 0), 0) for value in values]
    told = {b"".join(pieces) for pieces in sent if pieces is not None}
    assert len(told) == len(values), "the guard tells them apart"
    with pytest.raises(PolicyRefused, match="the test does not hold"):
        require_tests(read, layout_of)


@pytest.mark.attack("untried-values")
@pytest.mark.parametrize("says", ["no", "1.0"])
def test_a_cleared_field_that_a_condition_reads_is_told_by_what_comes(says: str) -> None:
    clear = {"rule": "{clear: true}", "says": says}
    require_tests(policy(TEXT.format(**clear, more="")), layout_of)
    asks = policy(TEXT.format(**clear, more=", when: msg.x < 5"))
    with pytest.raises(PolicyRefused, match="the test does not hold"):
        require_tests(asks, layout_of)
