"""`tests` of a policy, as they are read."""

import pytest

from grants.model import Right
from grants.policy.assertions import CheckedClaim, PolicyTest, Says, SeenField
from grants.policy.model import Subject
from tests.grants.policy.policies import HEADER, HEATING_KEY, mistakes, policy

HEAD = f"""{HEADER}identities:
  heating: {{node: /heating, key: "sha256:{HEATING_KEY.hex()}"}}
  nav: {{node: "/nav/**"}}
groups: {{robots: [/robot1, heating]}}
rules: []
tests:
"""


def read(text: str) -> tuple[PolicyTest, ...]:
    return policy(f"{HEAD}{text}\n").tests


def test_every_part_is_read() -> None:
    [found] = read(
        """  - who: heating
    may: {subscribe: [/robot/pose, /clock]}
    may_not: {publish: /cmd_vel}
    asks: {call: /door}
    sees: {/robot/pose: {pose.position: 2.0, header.frame_id: no, header.seq: exact}, /img: no}
    at: [2026-11-20T03:00:00Z, 2026-11-20T04:00:00+01:00]
    message: {header: {frame_id: map}, level: 3}"""
    )
    assert found.subject == Subject("/heating", HEATING_KEY)
    assert found.claims == (
        CheckedClaim(Says.MAY, Right.SUBSCRIBE, "/robot/pose", 10),
        CheckedClaim(Says.MAY, Right.SUBSCRIBE, "/clock", 10),
        CheckedClaim(Says.MAY_NOT, Right.PUBLISH, "/cmd_vel", 11),
        CheckedClaim(Says.ASKS, Right.CALL, "/door", 12),
        CheckedClaim(Says.MAY_NOT, Right.SUBSCRIBE, "/img", 13),
    )
    assert found.seen == (
        SeenField("/robot/pose", "pose.position", 2.0, 13),
        SeenField("/robot/pose", "header.frame_id", "no", 13),
        SeenField("/robot/pose", "header.seq", "exact", 13),
    )
    assert found.at == (1795143600, 1795143600)
    assert found.message == {"header.frame_id": "map", "level": 3}
    assert found.line == 9


def test_nodes_and_identities_are_subjects() -> None:
    names = ("/eve", "nav", "hospital:/rounds/robot3")
    found = [read(f"  - {{who: '{name}', may: {{call: /s}}}}")[0].subject.name for name in names]
    assert found == ["/eve", "/nav/x", "/remote/hospital/rounds/robot3"]


def test_a_group_is_each_of_its_members() -> None:
    found = read("  - {who: robots, may: {call: /s}}")
    assert [each.subject for each in found] == [
        Subject("/robot1", bytes(32)),
        Subject("/heating", HEATING_KEY),
    ]


def test_a_policy_needs_no_tests() -> None:
    assert policy(f"{HEADER}rules: []\ntests: []\n").tests == ()
    assert policy(f"{HEADER}rules: []\n").tests == ()


@pytest.mark.parametrize(
    ("test", "message"),
    [
        ("/a", "a test must be a mapping"),
        ("{may: {call: /s}}", "a test has no 'who'"),
        ("{who: /a}", "a test that tests nothing"),
        ("{who: heting, may: {call: /s}}", "not a node, identity or group: 'heting'"),
        ("{who: '*', may: {call: /s}}", "not a node, identity or group: '*'"),
        ("{who: '/a/*', may: {call: /s}}", "not a node, identity or group"),
        ("{who: /a, will: {call: /s}}", "unknown key 'will' in a test"),
        ("{who: /a, may: {dance: /s}}", "unknown right 'dance' in may"),
        ("{who: /a, may: {call: s}}", "call: "),
        ("{who: /a, may: /s}", "may must be a mapping"),
        ("{who: /a, sees: {/t: {x: -1}}}", "how a field is seen"),
        ("{who: /a, sees: {/t: {x: true}}}", "how a field is seen"),
        ("{who: /a, sees: {/t: 2}}", "sees /t must be a mapping"),
        ("{who: /a, may: {call: /s}, at: noon}", "not a time: 'noon'"),
        ("{who: /a, may: {call: /s}, message: {x: 1}}", "message needs at"),
        ("{who: /a, may: {call: /s}, at: 2026-11-20T03:00:00Z, message: [1]}", "message must be"),
    ],
)
def test_mistakes_are_found(test: str, message: str) -> None:
    found = mistakes(f"{HEAD}  - {test}\n")
    assert [each for each in found if each.message.startswith(message)], found
    assert all(each.line >= 8 for each in found)
