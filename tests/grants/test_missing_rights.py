"""The words for rights that no rule gives."""

import pytest
from ruamel.yaml import YAML

from grants.model import Right
from grants.request import MissingRight, missing_right, needed_rule, refusal


def test_a_status_names_what_is_missing() -> None:
    status = "rossec: /a needs the right call on /s: no grant for call on /s (grant 1 is for /t)"
    assert missing_right(status) == MissingRight("/a", "/a", Right.CALL, "/s")
    anonymous = "rossec: /a_17 (certified as /a) needs the right provide on /a_17/s: no grant x"
    found = missing_right(anonymous)
    assert found == MissingRight("/a", "/a_17", Right.PROVIDE, "/a_17/s")
    assert found.own == "{node}/s"
    assert str(found) == "/a may not provide /a_17/s"


@pytest.mark.parametrize(
    "status",
    [
        "rossec: /a needs the right call on /s: grant 12345678 has expired",
        "rossec: /a needs the right dance on /s: no grant for it",
        "rossec: this address is registered by another node",
        "needs the right call on /s: no grant",
        "",
    ],
)
def test_a_refusal_for_another_reason_is_none(status: str) -> None:
    assert missing_right(status) is None


def test_the_rule_that_is_named_can_be_written_so() -> None:
    rights = [(Right.PUBLISH, "/goal"), (Right.PROVIDE, "{node}/x"), (Right.PUBLISH, "/pose")]
    rule = needed_rule("/rviz", [*rights, *rights])
    assert rule == "an allow rule for /rviz with publish: [/goal, /pose], provide: ['{node}/x']"
    read = YAML(typ="safe", pure=True).load("{" + rule.partition("with ")[2] + "}")
    assert read == {"publish": ["/goal", "/pose"], "provide": ["{node}/x"]}


def test_all_that_a_node_lacks_is_one_line() -> None:
    one = refusal("/a", [(Right.CALL, "/s")])
    assert one == (
        "/a may not call /s: an allow rule for /a with call: [/s] would change it,"
        " or rossec grant sign /a --call /s"
    )
    several = refusal("/a", [(Right.CALL, "/s"), (Right.CALL, "/t"), (Right.CALL, "/s")])
    assert several == (
        "/a may not do all that it asks for: an allow rule for /a with call: [/s, /t]"
        " would change it, or rossec grant sign /a --call /s --call /t"
    )
