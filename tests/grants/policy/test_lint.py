"""Advice: what is allowed but unwise, above all what leaks beside a filter."""

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


def said(*lines: str, head: str = HEAD) -> list[str]:
    text = head + "rules:\n" + "".join(f"  - {line}\n" for line in lines)
    return [item.message for item in lint(policy(text), lambda t: parse(t, definition(t)))]


def test_a_wise_policy_gets_no_advice() -> None:
    assert said("{id: a, who: /x, why: w, allow: {publish: [/x/out], subscribe: [/odom]}}") == []


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
def test_one_piece_of_advice(line: str, message: str) -> None:
    assert said(line) == [message]


def test_no_lifetime_anywhere() -> None:
    line = "{id: a, who: /x, why: w, allow: {call: /b}}"
    assert said(line, head=HEADER) == ["rule a says no lifetime"]


def test_a_node_may_publish_below_its_own_name() -> None:
    assert said('{id: a, who: /x, why: w, allow: {publish: ["/x/**"]}}') == []
    assert said('{id: a, who: "/x/**", why: w, allow: {publish: ["/x/**"]}}') == []


ROUND = "filter: {pose.position: {round: 1}}"


def test_relatives_inside_the_message() -> None:
    found = said(f"{{id: a, who: /x, why: w, allow: {{subscribe: [/pose]}}, {ROUND}}}")
    for field in ("header.stamp", "header.seq", "pose.orientation"):
        assert any(f"pose.position of /pose is filtered, {field} is not" in m for m in found)
    assert any("comes at the full rate" in message for message in found)
    assert not any("twist" in message for message in found)


def test_twist_and_covariance_of_odometry() -> None:
    line = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/odom]}, filter: "
        "{pose.pose.position: {round: 5}}}"
    )
    found = said(line)
    assert any("twist is not: the exact path" in message for message in found)
    assert any("pose.covariance is not" in message for message in found)


WHOLE = "header: {clear: true}, pose.orientation: {clear: true}"


def test_other_topics_of_the_same_receiver() -> None:
    coarse = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/pose]}, "
        f"filter: {{pose.position: {{clear: true}}, {WHOLE}}}}}"
    )
    assert said(coarse) == []
    exact = "{id: b, who: /x, why: w, allow: {subscribe: [/odom, /tf]}}"
    assert said(coarse, exact) == [
        "rule a: /x sees /pose coarsely, but /odom exactly",
        "rule a: /x sees /pose coarsely, but /tf exactly",
    ]
    elsewhere = "{id: b, who: /y, why: w, allow: {subscribe: [/odom, /tf]}}"
    assert said(coarse, elsewhere) == []


def test_hysteresis_is_advised_where_it_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    line = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/pose]}, limit: {rate: 1}, "
        f"filter: {{pose.position: {{round: 1}}, {WHOLE}}}}}"
    )
    monkeypatch.setattr(module, "_knows_hysteresis", lambda: False)
    assert said(line) == []
    monkeypatch.setattr(module, "_knows_hysteresis", lambda: True)
    assert said(line) == ["rule a: pose.position is rounded without hysteresis"]


def test_whether_round_knows_hysteresis_is_asked_of_the_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "treatment_for", lambda _: None)
    assert module._knows_hysteresis()

    def refuse(_: object) -> None:
        raise GrantError("no such parameter")

    monkeypatch.setattr(module, "treatment_for", refuse)
    assert not module._knows_hysteresis()


def test_a_filter_of_something_else_is_no_place() -> None:
    line = (
        "{id: a, who: /x, why: w, allow: {subscribe: [/pose]}, "
        "filter: {header.frame_id: {clear: true}}}"
    )
    assert said(line) == []


def test_what_is_not_used() -> None:
    head = (
        HEAD + "identities: {i: {node: /i}, j: {node: /j}}\n"
        "filters: {f: {pose.position: {clear: true}}, g: {header: {clear: true}}}\n"
    )
    line = "{id: a, who: j, why: w, allow: {subscribe: [/pose]}, filter: {use: g}}"
    assert said(line, head=head) == [
        "filter f is used by no rule", "identity i is used by no rule",
    ]  # fmt: skip


def test_staying_connected_without_news_is_pointed_out() -> None:
    assert said("{id: a, who: /x, why: w, allow: {subscribe: /stop}, on_stale: keep}") == [
        "rule a: a revocation that is held back leaves /stop connected"
    ]
