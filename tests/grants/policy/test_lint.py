"""Advice: what is allowed but unwise, in particular what reveals filtered fields."""

import pytest

from grants.errors import GrantError
from grants.filters.layout import parse
from grants.policy import lint as module
from grants.policy.lint import lint
from tests.grants.policy.policies import HEADER, definition, policy

HEAD = (
    HEADER
    + """defaults: {lifetime: 7d}
types:
  /pose: geometry_msgs/PoseStamped
  /odom: nav_msgs/Odometry
"""
)


def advice(*lines: str, head: str = HEAD) -> list[str]:
    text = head + "rules:\n" + "".join(f"  - {line}\n" for line in lines)
    return [item.message for item in lint(policy(text), lambda t: parse(t, definition(t)))]


def test_a_wise_policy_gets_no_advice() -> None:
    assert advice("{id: a, who: /x, why: w, allow: {publish: [/x/out], subscribe: [/odom]}}") == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{id: a, who: /x, allow: {call: /b}}", "rule a gives no reason"),
        ("{id: a, who: /x, deny: {call: /b}}", "rule a gives no reason"),
        ("{id: a, who: /x, why: w, allow: {call: /b}, renew_until: 60w}",
         "rule a holds for more than a year"),
        ('{id: a, who: /x, why: w, allow: {publish: ["/arm/**"]}}',
         "rule a: publish on /arm/** may move anything"),
        ('{id: a, who: /x, why: w, prompt: {param-set: ["/**"]}}',
         "rule a: param-set on /** may move anything"),
    ],
)  # fmt: skip
def test_each_kind_of_advice(line: str, message: str) -> None:
    assert advice(line) == [message]


def test_a_missing_lifetime_is_advised() -> None:
    line = "{id: a, who: /x, why: w, allow: {call: /b}}"
    assert advice(line, head=HEADER) == ["rule a has no lifetime"]


def test_a_node_may_publish_below_its_own_name() -> None:
    assert advice('{id: a, who: /x, why: w, allow: {publish: ["/x/**"]}}') == []
    assert advice('{id: a, who: "/x/**", why: w, allow: {publish: ["/x/**"]}}') == []


ROUND = "filter: {pose.position: {round: 1}}"


def test_related_fields_of_the_message() -> None:
    found = advice(f"{{id: a, who: /x, why: w, allow: {{subscribe: [/pose]}}, {ROUND}}}")
    for field in ("header.stamp", "header.seq", "pose.orientation"):
        assert any(f"pose.position of /pose is filtered, {field} is not" in m for m in found)
    assert any("sent at the full rate" in message for message in found)
    assert not any("twist" in message for message in found)


def test_twist_and_covariance_of_odometry() -> None:
    line = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/odom]}, filter: "
        "{pose.pose.position: {round: 5}}}"
    )
    found = advice(line)
    assert any("twist is not: the exact path" in message for message in found)
    assert any("pose.covariance is not" in message for message in found)


WHOLE = "header: {clear: true}, pose.orientation: {clear: true}"


def test_other_topics_of_the_same_receiver() -> None:
    coarse = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/pose]}, "
        f"filter: {{pose.position: {{clear: true}}, {WHOLE}}}}}"
    )
    assert advice(coarse) == []
    exact = "{id: b, who: /x, why: w, allow: {subscribe: [/odom, /tf]}}"
    assert advice(coarse, exact) == [
        "rule a: /x sees /pose coarsely, but /odom exactly",
        "rule a: /x sees /pose coarsely, but /tf exactly",
    ]
    elsewhere = "{id: b, who: /y, why: w, allow: {subscribe: [/odom, /tf]}}"
    assert advice(coarse, elsewhere) == []


def test_hysteresis_is_advised_if_supported(monkeypatch: pytest.MonkeyPatch) -> None:
    line = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/pose]}, limit: {rate: 1}, "
        f"filter: {{pose.position: {{round: 1}}, {WHOLE}}}}}"
    )
    monkeypatch.setattr(module, "_supports_hysteresis", lambda: False)
    assert advice(line) == []
    monkeypatch.setattr(module, "_supports_hysteresis", lambda: True)
    assert advice(line) == ["rule a: pose.position is rounded without hysteresis"]


def test_whether_round_supports_hysteresis_is_asked_of_the_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "treatment_for", lambda _: None)
    assert module._supports_hysteresis()

    def refuse(_: object) -> None:
        raise GrantError("no such parameter")

    monkeypatch.setattr(module, "treatment_for", refuse)
    assert not module._supports_hysteresis()


def test_filters_of_other_fields_get_no_advice() -> None:
    line = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/pose]}, "
        "filter: {header.frame_id: {clear: true}}}"
    )
    assert advice(line) == []


def test_unused_identities_and_filters() -> None:
    head = (
        HEAD + "identities: {i: {node: /i}, j: {node: /j}}\n"
        "filters: {f: {pose.position: {clear: true}}, g: {header: {clear: true}}}\n"
    )
    line = "{id: a, who: j, why: w, allow: {subscribe: [/pose]}, filter: {use: g}}"
    assert advice(line, head=head) == [
        "filter f is used by no rule", "identity i is used by no rule",
    ]  # fmt: skip


def test_keep_on_stale_is_advised_against() -> None:
    assert advice("{id: a, who: /x, why: w, allow: {subscribe: /stop}, on_stale: keep}") == [
        "rule a: if revocation data is withheld, /stop stays connected"
    ]
