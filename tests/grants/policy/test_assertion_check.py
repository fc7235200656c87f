"""Whether the tests of a policy hold."""

import pytest

from grants.errors import PolicyRefused
from grants.policy.assertion_check import CheckOutcome, check_tests, require_tests
from rossec.authority.policyfile import layout_of
from tests.grants.policy.policies import policy

NIGHT, DAY = "2026-11-20T03:00:00Z", "2026-11-20T12:00:00Z"
FROM_MAP = f"at: {DAY}, message: {{header: {{frame_id: map}}}}"
TEXT = """rossec: 1
robot: test
basics: true
types: {/robot/pose: geometry_msgs/PoseStamped}
rules:
  - {id: drive, who: /robot, allow: {publish: [~/pose, /cmd_vel]}}
  - id: room
    who: /heating
    allow: {subscribe: [/robot/pose]}
    when: ['now.getHours("UTC") >= 6', 'msg.header.frame_id == "map"']
    filter: {pose.position: {round: 2.0}, header.frame_id: {clear: true}}
  - {id: lift, who: /robot, prompt: {call: /lift}}
  - {id: no-arms, who: /robot, deny: {publish: [/arm/**, /robot/arm]}}
  - {id: all, who: /doctor, allow: {subscribe: /**}}
  - {id: no-camera, who: /doctor, deny: {subscribe: /camera/**}}
tests:
"""


def outcomes(test: str, text: str = TEXT) -> list[CheckOutcome]:
    return check_tests(policy(f"{text}  - {test}\n"), layout_of)


@pytest.mark.parametrize(
    "test",
    [
        "{who: /robot, may: {publish: [/cmd_vel, /robot/pose, ~/pose]}}",
        "{who: /robot, may: {publish: /rosout, provide: '{node}/get_loggers'}}",
        "{who: /robot, asks: {call: /lift}}",
        "{who: /robot, may_not: {publish: /arm/left, subscribe: /robot/pose}}",
        "{who: /robot, may_not: {publish: [/arm/**, '/arm/*']}}",
        "{who: /heating, may: {subscribe: /robot/pose}}",
        "{who: /heating, may_not: {publish: /**, call: /**}}",
        "{who: /doctor, may_not: {subscribe: [/camera/**, /camera/front]}}",
        f"{{who: /heating, may_not: {{subscribe: /robot/pose}}, at: {NIGHT}}}",
        f"{{who: /heating, may_not: {{subscribe: /robot/pose}}, at: {DAY}}}",
        f"{{who: /heating, may: {{subscribe: /robot/pose}}, {FROM_MAP}}}",
        "{who: /heating, sees: {/robot/pose: {pose.position: 2.0, header.frame_id: no}}}",
        "{who: /heating, sees: {/robot/pose: {pose.orientation: exact}, /camera/front: no}}",
        "{who: /doctor, sees: {/robot/pose: {pose.position: exact}}}",
    ],
)
def test_what_is_true_holds(test: str) -> None:
    found = outcomes(test)
    assert found
    assert [each for each in found if not each] == []


@pytest.mark.parametrize(
    ("test", "failure", "needed"),
    [
        (
            "{who: /eve, may: {publish: /cmd_vel}}",
            "/eve may not publish /cmd_vel: no rule matches, so the default decides",
            "an allow rule for /eve with publish: [/cmd_vel]",
        ),
        (
            "{who: /robot, may_not: {publish: /cmd_vel}}",
            "/robot may publish /cmd_vel: rule drive, line 6",
            "without drive it would be deny",
        ),
        ("{who: /robot, may: {publish: /arm/left}}", "rule no-arms, line 13", "without no-arms"),
        ("{who: /robot, may: {call: /lift}}", "may, if a person says so, call /lift", "lift"),
        ("{who: /robot, may_not: {call: /lift}}", "may, if a person says so, call", "lift"),
        ("{who: /robot, asks: {publish: /cmd_vel}}", "may publish /cmd_vel", "drive"),
        (
            "{who: /robot, may_not: {publish: /**}}",
            "/robot may publish /robot/pose: rule drive, line 6",
            "take /robot/pose out of drive, or deny it",
        ),
        ("{who: /doctor, may_not: {subscribe: /robot/**}}", "rule all, line 14", "out of all"),
        ("{who: /robot, may_not: {call: /**}}", "may, if a person says so, call /lift", "lift"),
        (
            f"{{who: /heating, may: {{subscribe: /robot/pose}}, at: {NIGHT}}}",
            '2026-11-20 03:00:00 UTC: not true: now.getHours("UTC") >= 6',
            "change the condition",
        ),
        (
            f"{{who: /heating, may: {{subscribe: /robot/pose}}, at: {DAY}}}",
            'not true: msg.header.frame_id == "map"',
            "change the condition",
        ),
        (
            f"{{who: /heating, may_not: {{subscribe: /robot/pose}}, {FROM_MAP}}}",
            "may subscribe /robot/pose at 2026-11-20 12:00:00 UTC: rule room, line 7",
            "without room",
        ),
        (
            f"{{who: /heating, may: {{subscribe: /robot/pose}}, at: {DAY}, message: {{x: 1}}}}",
            "geometry_msgs/PoseStamped has no field 'x'",
            "correct the test",
        ),
        (
            "{who: /heating, sees: {/robot/pose: {pose.position: 2.5}}}",
            "/heating sees pose.position.x of /robot/pose finer than 2.5: rule room, line 7",
            "a filter on pose.position in room",
        ),
        ("{who: /heating, sees: {/robot/pose: {pose: exact}}}", "otherwise than it is", "filter"),
        ("{who: /doctor, sees: {/robot/pose: {header.seq: no}}}", "header.seq of", "filter"),
        ("{who: /doctor, sees: {/robot/pose: {header.seq: room}}}", "not how a field", "number"),
        ("{who: /doctor, sees: {/robot/pose: {header.frame_id: 2}}}", "is no number", "exact"),
        ("{who: /doctor, sees: {/robot/pose: {speed: no}}}", "no field 'speed'", "correct"),
        ("{who: /doctor, sees: {/scan: {ranges: no}}}", "type of /scan is unknown", "add it"),
        (
            "{who: /robot, sees: {/robot/pose: {pose.position: 2.0}}}",
            "/robot may not subscribe /robot/pose",
            "if it is to see nothing, write /robot/pose: no",
        ),
    ],
)
def test_what_is_not_true_fails_with_the_rule_and_what_is_needed(
    test: str, failure: str, needed: str
) -> None:
    [found] = [each for each in outcomes(test) if not each]
    assert failure in found.failure
    assert needed in found.needed
    assert found.line == 17


def test_a_policy_is_required_to_hold() -> None:
    require_tests(policy(f"{TEXT}  - {{who: /eve, may_not: {{call: /lift}}}}\n"), layout_of)
    wrong = policy(f"{TEXT}  - {{who: /eve, may: {{call: [/lift, /door]}}}}\n")
    with pytest.raises(PolicyRefused, match=r"test.yaml:17: the test does not hold") as error:
        require_tests(wrong, layout_of)
    assert str(error.value).endswith("(and 1 more)")
    assert "rossec policy test" in error.value.hint


def test_filters_count_not_words() -> None:
    """A filter of another rule makes it finer than the name of the first says."""
    finer = TEXT.replace("round: 2.0", "round: 1.0").replace("room", "two-metres")
    [found] = outcomes("{who: /heating, sees: {/robot/pose: {pose.position: 2.0}}}", finer)
    assert not found


_KEY = "sha256:" + "ab" * 32
_HIDING = """rossec: 1
robot: test
defaults: {decision: %s}
identities: {pinned: {node: /heating, key: "%s"}, robots: {node: "/robots/*"}}
rules:
  - {id: pinned, who: pinned, allow: {subscribe: /pose}}
  - {id: own, who: [/rviz, /cart], allow: {publish: [~/pose, /a/*]}}
  - {id: cart, who: /cart_2, allow: {publish: /b}}
  - {id: one, who: /robots/r1, allow: {call: /lift}}
  - {id: basics, why: what every ROS program needs, who: /heating, allow: {subscribe: /camera/left}}
tests:
"""


@pytest.mark.parametrize(
    ("test", "failure"),
    [
        ("{who: /heating, may_not: {subscribe: /pose}}", "/heating may subscribe /pose"),
        ("{who: /heating, may_not: {subscribe: '/*'}}", "/heating may subscribe /pose"),
        ("{who: /rviz, may_not: {publish: ~/**}}", "/rviz may publish /rviz/pose"),
        ("{who: /rviz, may_not: {publish: /rviz_1/pose}}", "certified with --anonymous, may"),
        ("{who: /rviz, may_not: {publish: /rviz_1/**}}", "certified with --anonymous, may"),
        ("{who: robots, may_not: {call: /lift}}", "/robots/r1 may call /lift"),
        ("{who: /heating, may_not: {subscribe: /camera/**}}", "may subscribe /camera/left"),
    ],
)
def test_what_must_not_be_is_found_for_every_node_it_may_be_about(test: str, failure: str) -> None:
    """Each held, although what apply signs gives it."""
    [found] = outcomes(test, _HIDING % ("deny", _KEY))
    assert failure in found.failure


@pytest.mark.parametrize(
    "test",
    [
        "{who: /cart, may_not: {publish: /cart_2/pose}}",
        "{who: /rviz, may_not: {publish: [/rvizx/pose, '~/arm/**']}}",
        "{who: robots, may_not: {call: /door}}",
        "{who: /other, may_not: {subscribe: /pose}}",
        "{who: /other, sees: {~/pose: no}}",
    ],
)
def test_no_other_node_is_meant(test: str) -> None:
    assert all(outcomes(test, _HIDING % ("deny", _KEY)))


def test_a_default_that_asks_is_not_no() -> None:
    [found] = outcomes("{who: /other, may_not: {subscribe: /x/**}}", _HIDING % ("prompt", _KEY))
    assert "if a person says so, subscribe /x/**: no rule matches" in found.failure


def test_a_field_is_seen_as_with_the_key_that_is_pinned() -> None:
    text = f"""rossec: 1
robot: test
types: {{/pose: geometry_msgs/PoseStamped}}
identities: {{pinned: {{node: /heating, key: "{_KEY}"}}}}
rules:
  - {{id: a, who: /heating, except: pinned, allow: {{subscribe: /pose}}, see: {{position: room}}}}
  - {{id: b, who: /heating, allow: {{subscribe: /pose}}}}
tests:
"""
    [found] = outcomes("{who: /heating, sees: {/pose: {position: room}}}", text)
    assert "/heating sees position (exact" in found.failure


def test_slots_do_not_keep_a_field_from_being_tried() -> None:
    text = """rossec: 1
robot: test
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: a, who: /h, allow: {subscribe: /pose}, see: {position: room, presence: minute}}
tests:
"""
    found = outcomes("{who: /h, sees: {/pose: {pose.position: 4.0, header.stamp: no}}}", text)
    assert [each.failure for each in found] == ["", ""]


TREES = """rossec: 1
robot: r
identities: {{phone: {{key: "sha256:{key}"}}}}
rules:
  - {{id: r, who: {who}, allow: {{{right}: [{name}]}}}}
tests:
  - {{who: /a, may_not: {{{right}: [{asked}]}}}}
"""


@pytest.mark.parametrize("right", ["param-set", "param-get"])
@pytest.mark.parametrize(
    ("name", "asked", "holds"),
    [
        ("/safety/max_speed", "/safety", False),
        ("/safety/a/b", "/safety", False),
        ("/safety", "/safety/max_speed", False),
        ("/**", "/safety", False),
        ("/safety", "/safety", False),
        ("/safetyx", "/safety", True),
        ("/other/safety", "/safety", True),
        ("'{node}/p'", "/a", False),
    ],
)
def test_a_parameter_that_may_not_be_set_is_so_in_all_its_parts(
    right: str, name: str, asked: str, *, holds: bool
) -> None:
    text = TREES.format(key="11" * 32, who="/a", right=right, name=name, asked=asked)
    (outcome,) = check_tests(policy(text), layout_of)
    assert bool(outcome) is holds


def test_an_identity_that_is_a_key_alone_may_be_any_node() -> None:
    text = TREES.format(key="11" * 32, who="phone", right="publish", name="/x", asked="/x")
    (outcome,) = check_tests(policy(text), layout_of)
    assert not outcome
