"""Refusals in the audit: one line for each cause."""

from grants.model import Right
from rossec.master.api.methods import CallDenied
from rossec.master.server.effects import LOGGED_FOR, MAX_CAUSES, DenialCauses


def denied(
    right: Right, name: str, *, node: str = "/rviz", reason: str = "no grant for it", method: str = "m"
) -> CallDenied:
    status = f"rossec: {node} needs the right {right.label} on {name}: {reason}"
    return CallDenied(node, method, status, None, (right, name), node, wildcard=True)


def test_a_cause_is_logged_with_the_rule_that_is_missing() -> None:
    text = DenialCauses().text(0, denied(Right.PUBLISH, "/goal", method="registerPublisher"))
    rule = "an allow rule for /rviz with publish: [/goal]"
    assert text == f"publish /goal (registerPublisher): {rule} would change it"


def test_a_cause_is_logged_once_an_hour_with_what_was_left_out() -> None:
    causes = DenialCauses()
    goal = denied(Right.PUBLISH, "/goal")
    assert causes.text(0, goal) is not None
    assert causes.text(1, goal) is None
    assert causes.text(LOGGED_FOR - 1, goal) is None
    again = causes.text(LOGGED_FOR, goal)
    assert again is not None
    assert again.endswith("(2 more like this since it was logged last)")
    last = causes.text(2 * LOGGED_FOR, goal)
    assert last is not None
    assert "more like this" not in last


def test_other_rights_names_nodes_and_reasons_are_other_causes() -> None:
    causes = DenialCauses()
    assert causes.text(0, denied(Right.PUBLISH, "/goal"))
    assert causes.text(0, denied(Right.SUBSCRIBE, "/goal"))
    assert causes.text(0, denied(Right.PUBLISH, "/pose"))
    assert causes.text(0, denied(Right.PUBLISH, "/goal", node="/eve"))
    expired = causes.text(0, denied(Right.PUBLISH, "/goal", reason="grant 12345678 has expired"))
    assert expired == "publish /goal (m): grant 12345678 has expired"


def test_runs_of_an_anonymous_node_are_one_cause() -> None:
    causes = DenialCauses()
    text = causes.text(0, denied(Right.PROVIDE, "/rviz_17/load"))
    assert text is not None
    assert "provide: ['{node}/load']" in text
    assert causes.text(0, denied(Right.PROVIDE, "/rviz_18/load")) is None


def test_what_every_program_asks_for_is_one_cause_of_each_node() -> None:
    causes = DenialCauses()
    text = causes.text(0, denied(Right.PUBLISH, "/rosout"))
    assert text is not None
    assert "basics: true in a policy would change it" in text
    assert causes.text(0, denied(Right.PARAM_GET, "/use_sim_time")) is None
    assert causes.text(0, denied(Right.PROVIDE, "/rviz_17/get_loggers")) is None
    assert causes.text(0, denied(Right.PUBLISH, "/rosout", node="/eve"))
    assert causes.text(0, denied(Right.SUBSCRIBE, "/clock"))
    assert causes.text(0, denied(Right.PROVIDE, "/other/get_loggers"))


def test_refusals_for_other_reasons_are_all_logged() -> None:
    causes = DenialCauses()
    taken = CallDenied("/eve", "registerPublisher", "rossec: this address is registered")
    for _ in range(3):
        assert causes.text(0, taken) == "registerPublisher: rossec: this address is registered"


def test_the_number_of_causes_is_bounded() -> None:
    causes = DenialCauses()
    for number in range(MAX_CAUSES + 1):
        assert causes.text(0, denied(Right.CALL, f"/s{number}"))
    assert causes.text(0, denied(Right.CALL, "/s0"))
    assert causes.text(0, denied(Right.CALL, f"/s{MAX_CAUSES}")) is None


def test_a_clock_that_was_put_back_hides_nothing() -> None:
    causes = DenialCauses()
    assert causes.text(1000, denied(Right.CALL, "/s"))
    assert causes.text(10, denied(Right.CALL, "/s"))
