"""One rule: its structure, its subjects, and the restriction of each of its topics."""

import pytest

from grants.model import FilterRule, Restriction, Right
from grants.policy.model import HOUR, Effect
from tests.grants.policy.policies import HEADER, mistakes, policy, rules

HEAD = (
    HEADER
    + """identities: {x: {node: /x}}
types: {/pose: geometry_msgs/PoseStamped, /scan: sensor_msgs/LaserScan}
filters: {place: {pose.position: {round: 1}}}
"""
)


def read(line: str) -> object:
    return rules(line, head=HEAD).rules[0]


def found(line: str) -> list[tuple[str, str]]:
    return [(m.message, m.hint) for m in mistakes(HEAD + f"rules:\n  - {line}\n")]


def test_subjects_rights_and_validity() -> None:
    (rule,) = rules(
        '{id: a, who: [x, /y/*, "*"], except: /z, prompt: {call: /b, param-get: [/c, /d]}, '
        "lifetime: 2h, renew_until: never}",
        head=HEAD,
    ).rules
    assert rule.effect is Effect.PROMPT
    assert [(who.label, who.node) for who in rule.who] == [("x", "/x"), ("/y/*", "/y/*"), ("*", "/**")]
    assert [who.label for who in rule.exceptions] == ["/z"]
    assert [(item.right, item.pattern) for item in rule.clauses] == [
        (Right.CALL, "/b"),
        (Right.PARAM_GET, "/c"),
        (Right.PARAM_GET, "/d"),
    ]
    assert (rule.lifetime, rule.renew_until, rule.has_lifetime) == (2 * HOUR, 0, True)


def test_a_filter_for_one_of_two_topics() -> None:
    (rule,) = rules(
        "{id: a, who: x, allow: {subscribe: [/pose, /scan, /else], publish: /cmd}, "
        "filter: {/pose: {use: place}, /scan: {ranges: {drop: true}}}, limit: {rate: 2}}",
        head=HEAD,
    ).rules
    place = (FilterRule("pose.position", "round", (("step", 1),)),)
    expected = {
        "/pose": Restriction("geometry_msgs/PoseStamped", (), place),
        "/scan": Restriction("sensor_msgs/LaserScan", (), (FilterRule("ranges", "drop"),)),
        "/else": None,
        "/cmd": None,
    }
    assert {item.pattern: item.restriction for item in rule.clauses} == expected
    assert {item.pattern: item.rate for item in rule.clauses} == {
        "/pose": 2,
        "/scan": 2,
        "/else": 2,
        "/cmd": None,
    }


def test_a_coarse_position_has_a_slot_and_no_rate() -> None:
    for limit, rate in (("", None), (", limit: {rate: 0.01}", 0.01)):
        (rule,) = rules(
            f"{{id: a, who: x, allow: {{subscribe: /pose}}, filter: {{use: coarse-position}}{limit}}}",
            head=HEAD,
        ).rules
        (clause,) = rule.clauses
        assert clause.rate == rate
        assert clause.restriction is not None
        assert clause.restriction.slot == 30
        assert "pose.position" in {item.path for item in clause.restriction.filters}
    ((message, hint),) = found("{id: a, who: x, allow: {subscribe: /scan}, filter: {use: coarse-position}}")
    assert message.startswith("coarse-position: the preset does not support sensor_msgs/Laser")
    assert hint.startswith("it supports geometry_msgs/PoseStamped")


def test_a_preset_has_its_own_slot() -> None:
    (rule,) = rules(
        "{id: a, who: x, allow: {subscribe: /pose}, filter: {use: presence-only}}", head=HEAD
    ).rules
    (clause,) = rule.clauses
    assert clause.restriction is not None
    assert (clause.rate, clause.restriction.slot) == (None, 60)
    assert clause.lines()[-1] == "one message at the start of each 60 s"


def test_a_condition_on_time_needs_no_type() -> None:
    (rule,) = rules(
        "{id: a, who: x, allow: {subscribe: /unknown, call: /b}, when: [now.getHours() > 5]}", head=HEAD
    ).rules
    assert {item.restriction for item in rule.clauses} == {Restriction(None, ("now.getHours() > 5",))}


@pytest.mark.parametrize(
    ("line", "message", "hint"),
    [
        ("just words", "a rule must be a mapping", "write key: value"),
        ("{id: a, who: y, allow: {call: /b}}", "unknown identity 'y'", "expected one of x"),
        ("{id: a, who: x, allow: {call: /b/}}", "call: not a name pattern", "segment"),
        (
            "{id: a, who: x, allow: {subscribe: /pose}, filter: {/poze: {header: {clear: true}}}}",
            "rule a has no subscribe right on '/poze'",
            "'/pose'",
        ),
        ("{id: a, who: x}", "rule a needs one of allow, deny and prompt", "for example allow"),
        ("{id: a, who: x, allow: {call: /b}, deny: {call: /b}}", "rule a needs one", "two rules"),
        ("{id: a, who: x, allow: 5}", "allow of rule a must be a mapping", "write key: value"),
        ("{id: a, who: x, allow: {}}", "rule a has no rights", "expected one of"),
        ("{id: a, who: x, allow: {call: []}}", "rule a: call has no names", "add a name"),
        ("{id: a, who: x, allow: {cal: /b}}", "unknown right 'cal' in rule a", "'call'"),
        ("{id: a b, who: x, allow: {call: /b}}", "not an id: 'a b'", "letters"),
        ("{who: x, allow: {call: /b}}", "rule ? has no 'id'", "add id: ..."),
        ("{id: a, allow: {call: /b}}", "rule a has no 'who'", "add who: ..."),
        ("{id: a, who: 5, allow: {call: /b}}", "who must be text", "quotes"),
        ("{id: a, who: /y/, allow: {call: /b}}", "who: not a name pattern", "segment"),
        (
            "{id: a, who: x, deny: {call: /b}, lifetime: 1d}",
            "rule a: a deny rule cannot have 'lifetime'",
            "remove it",
        ),
        (
            "{id: a, who: x, allow: {param-get: /b}, when: now.getHours() > 5}",
            "rule a: parameters, graph and admin rights",
            "separate rule",
        ),
        (
            "{id: a, who: x, allow: {call: /pose}, when: msg.header.seq > 5}",
            "call /pose: conditions on messages are for topics",
            "separate rule",
        ),
        (
            "{id: a, who: x, allow: {subscribe: /b}, when: msg.header.seq > 5}",
            "the message type of /b is unknown",
            "add it to types: {/b: package/Type}",
        ),
        (
            "{id: a, who: x, allow: {call: /b}, filter: {use: place}}",
            "rule a: nothing to filter",
            "add a subscribe or publish right",
        ),
        ("{id: a, who: x, allow: {subscribe: /pose}, filter: {}}", "rule a: nothing to filter", ""),
        ("{id: a, who: x, allow: {subscribe: /pose}, filter: 5}", "filter of rule a must be a", ""),
        ("{id: a, who: x, allow: {subscribe: /pose}, filter: {/pose: 5}}", "filter of /pose must", ""),
        (
            "{id: a, who: x, allow: {subscribe: /pose}, filter: {use: plaze}}",
            "unknown filter: 'plaze'",
            "'place'",
        ),
        (
            "{id: a, who: x, allow: {subscribe: /pose}, filter: {use: place, x: 1}}",
            "unknown key 'x' in a filter with use",
            "expected one of use",
        ),
        ("{id: a, who: x, allow: {call: /b}, limit: {rate: 1}}", "rule a: nothing to limit", "add"),
        ("{id: a, who: x, allow: {subscribe: /b}, limit: {rate: 0}}", "rate must be a number", ""),
        ("{id: a, who: x, allow: {subscribe: /b}, limit: 5}", "limit of rule a must be a", ""),
        (
            "{id: a, who: x, allow: {subscribe: /pose}, filter: {pose: {clear: true}, use: place}}",
            "unknown key 'pose' in a filter with use",
            "",
        ),
    ],
)
def test_mistakes_of_a_rule(line: str, message: str, hint: str) -> None:
    about = [(m, h) for m, h in found(line) if m.startswith(message)]
    assert about, found(line)
    assert hint in about[0][1]


def test_an_unknown_type_is_reported_once() -> None:
    text = HEADER + "types: {/b: no/Type}\nrules:\n  - {id: a, who: /x, allow: {subscribe: /b}, "
    (only,) = mistakes(text + "filter: {x: {clear: true}}}\n")
    assert only.message == "unknown message type 'no/Type'"


def test_a_restriction_invalid_in_a_grant_is_a_mistake() -> None:
    long = "now.getHours() > 5" + " " * 1000
    assert len(found(f"{{id: a, who: x, allow: {{call: /b}}, when: '{long}'}}")) == 1


def test_a_valid_policy_has_rules() -> None:
    assert policy().rules


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{id: a, who: x, allow: {call: /b}, on_stale: stay}", "unknown on_stale: 'stay'"),
        ("{id: a, who: x, deny: {call: /b}, on_stale: keep}", "rule a: a deny rule cannot have 'on_stale'"),
        (
            "{id: a, who: x, allow: {graph: /b}, on_stale: keep}",
            "rule a: parameters, graph and admin rights cannot have restrictions",
        ),
    ],
)
def test_invalid_uses_of_on_stale(line: str, message: str) -> None:
    assert [said for said, _ in found(line)] == [message]


def test_a_subject_with_a_label_is_a_node_of_another_domain() -> None:
    line = '{id: a, who: ["hospital:/rounds/*", /y], allow: {subscribe: [/pose], graph: [/remote/**]}}'
    (rule,) = rules(line, head=HEAD).rules
    assert [(who.label, who.node) for who in rule.who] == [
        ("hospital:/rounds/*", "/remote/hospital/rounds/*"),
        ("/y", "/y"),
    ]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{id: a, who: /remote/hospital/a, allow: {call: /b}}", "with the label of the domain"),
        ('{id: a, who: "hospital:a", allow: {call: /b}}', "who: not a name pattern"),
        ('{id: a, who: "*:/a", allow: {call: /b}}', "is not a label"),
        ('{id: a, who: /a, allow: {call: "hospital:/b"}}', "'hospital:/b' is a name of another"),
        ('{id: a, who: /a, allow: {graph: "hospital:/b"}}', "'hospital:/b' is a name of another"),
        ("{id: a, who: /a, allow: {subscribe: /remote/hospital/b}}", "is a name of another domain"),
    ],
)
def test_names_of_other_domains_are_subjects_and_no_objects(line: str, message: str) -> None:
    ((said, hint),) = found(line)
    assert message in said
    assert hint


_OTHER_TOPIC = (
    "types: {~/pose: geometry_msgs/PoseStamped}\nrules: [{id: a, who: /x, allow:"
    " {subscribe: ~/pose}, filter: {~/poze: {header: {clear: true}}}}]\n"
)
OWN_TYPES = 'rossec: 1\nrobot: r\ntypes: {"~/pose": geometry_msgs/PoseStamped}\n'


def test_own_topics_have_types_and_filters() -> None:
    (rule,) = rules(
        '{id: a, who: /x, allow: {subscribe: ["{node}/pose", /b]}, '
        "filter: {~/pose: {pose.orientation: {clear: true}}}}",
        head=OWN_TYPES,
    ).rules
    own, other = rule.clauses
    assert (own.pattern, own.type, other.restriction) == ("{node}/pose", "geometry_msgs/PoseStamped", None)
    assert own.restriction is not None
    (plain,) = rules(
        "{id: a, who: /x, allow: {subscribe: /x/pose}, filter: {use: coarse-position}}", head=OWN_TYPES
    ).rules
    assert plain.clauses[0].type == "geometry_msgs/PoseStamped"


def test_a_wide_type_is_that_of_own_topics() -> None:
    head = OWN_TYPES.replace('"~/pose"', '"/**/pose"')
    (rule,) = rules(
        "{id: a, who: /x, allow: {subscribe: ~/pose}, filter: {use: coarse-position}}", head=head
    ).rules
    assert rule.clauses[0].type == "geometry_msgs/PoseStamped"


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("types: {'{node}': std_msgs/String}\nrules: []\n", "{node} is no topic", "~/pose"),
        (
            "rules: [{id: a, who: /x, allow: {subscribe: ~/b}, when: msg.data == 'x'}]\n",
            "the message type of {node}/b is unknown",
            "types: {~/b: package/Type}",
        ),
        ("rules: [{id: a, who: /x, allow: {publish: '{me}/b'}}]\n", "'{me}'", "~/pose"),
        ("rules: [{id: a, who: /x, allow: {publish: {node}}}]\n", "without quotes", '"{node}"'),
        ("rules: [{id: a, who: '/robot*', allow: {publish: /b}}]\n", "'/robot*'", "groups:"),
        ("rules: [{id: a, who: /x, allow: {publish: '/robot*/b'}}]\n", "part of a segment", "~/"),
        (_OTHER_TOPIC, "no subscribe right on '{node}/poze'", "{node}/pose"),
    ],
)
def test_mistakes_in_own_names(text: str, message: str, hint: str) -> None:
    (mistake,) = mistakes("rossec: 1\nrobot: r\n" + text)
    assert message in mistake.message
    assert hint in mistake.hint
    assert mistake.line > 2
    assert mistake.column > 1


def test_a_body_needs_a_slot_and_is_in_the_restriction() -> None:
    text = "{{id: a, who: x, allow: {{subscribe: [/pose]}}, limit: {{{}}}{}}}"
    (rule,) = rules(text.format("slot: 60, body: robot", ""), head=HEAD).rules
    assert [item.restriction for item in rule.clauses] == [Restriction(slot=60, body="robot")]
    coarse = ", filter: {use: coarse-position}"
    (rule,) = rules(text.format("body: robot", coarse), head=HEAD).rules
    (clause,) = rule.clauses
    assert clause.restriction is not None
    assert (clause.restriction.slot, clause.restriction.body) == (30, "robot")
    ((message, hint),) = found(text.format("body: robot", ""))
    assert message == "subscribe /pose: without a slot the body robot cannot be told in common"
    assert hint == "for example limit: {slot: 30}"
