from grants.policy.model import Subject
from grants.policy.read import load
from grants.policy.wanted import projected_for_names, projected_grants
from tests.grants.policy.policies import HEATING, OTHER_KEY, definition, policy, rules


def test_rules_for_a_name_are_listed() -> None:
    found = projected_grants(policy(), HEATING)
    assert found[0] == "allow subscribe /robot/pose (rule heating-room: Heating lowers rooms.)"
    assert "  pose.position: {round: 2.0}" in found or any("pose.position" in line for line in found)
    assert "  at most 0.2 messages a second" in found
    assert "allow publish /heating/** (rule heating-own)" in found
    assert found[-1] == "deny subscribe /camera/** (rule no-camera: no)"


def test_a_pinned_rule_is_not_for_another_key() -> None:
    found = projected_grants(policy(), Subject("/heating", OTHER_KEY))
    assert found == ["deny subscribe /camera/** (rule no-camera: no)"]


def test_rules_for_the_names_of_a_pattern_are_listed_with_whom_they_are_for() -> None:
    found = projected_for_names(policy(), "/nav/*")
    assert found == [
        "navigation: allow publish /cmd_vel (rule nav-full)",
        "navigation: allow subscribe /robot/pose (rule nav-full)",
        "* except navigation: deny subscribe /camera/** (rule no-camera: no)",
    ]
    assert "heating: " in projected_for_names(policy(), "/**")[0]
    assert projected_for_names(policy(), "/other") == found[-1:]


def test_own_names_are_shown_for_the_name() -> None:
    own = rules('{id: a, who: "*", allow: {publish: [~/pose]}}')
    assert projected_grants(own, HEATING) == ["allow publish {node}/pose, here /heating/pose (rule a)"]
    assert projected_grants(own, Subject("/remote/lab/a", OTHER_KEY)) == []
    assert projected_for_names(own, "/nav/*") == ["*: allow publish {node}/pose (rule a)"]


def test_what_every_program_needs_is_one_line() -> None:
    """A screen of twelve lines for each node that is invited hid what matters."""
    whole = load(
        "rossec: 1\nrobot: r\nbasics: true\n"
        'rules: [{id: a, who: "*", why: it shines, allow: {publish: [/lamp]}}]\n',
        definition,
    )
    basics = "allow what every ROS program needs: its log, its loggers, the clock (rule basics)"
    lamp = "allow publish /lamp (rule a: it shines)"
    assert sorted(projected_grants(whole, HEATING)) == [lamp, basics]
    assert sorted(projected_for_names(whole, "/*")) == [f"*: {lamp}", f"*: {basics}"]
