"""Advice on rules as such, with what it says to do."""

import pytest

from grants.policy.lint import lint
from tests.grants.policy.lint_cases import findings, layout_of, messages, text_of
from tests.grants.policy.lint_leaks import RULES, Leak
from tests.grants.policy.policies import policy

HINTS = {
    "no reason": "add why: ...",
    "more than a year": "shorten it",
    "every arm": "name the topics and services one by one",
    "each other's poses": 'write "{node}/pose"',
    "each other's poses, below a namespace": 'write "{node}/pose"',
    "each other's services": 'write "{node}/get_loggers"',
    "a right that is denied": "remove it, or narrow the other",
    "an identity": "remove it, or use it",
    "a type": "remove it, or correct the name",
}


@pytest.mark.parametrize("leak", RULES, ids=lambda leak: leak.name)
def test_what_to_do(leak: Leak) -> None:
    [finding] = findings(text_of(*leak.rules, head=leak.head, types=dict(leak.types)))
    assert finding.code == leak.codes
    assert finding.hint.startswith(HINTS.get(leak.name, ""))


def test_who_can_act_for_whom() -> None:
    assert messages("id: a, who: '/robots/*', allow: {publish: ['/*/pose']}") == [
        "rule a: with publish on /*/pose each of /robots/* can act for the others"
    ]
    assert messages("id: a, who: [/one, /two], allow: {provide: ['/a/*/go']}") == [
        "rule a: with provide on /a/*/go each of /one, /two can act for the others"
    ]
    assert messages("id: a, who: [/one, /two], allow: {subscribe: ['/a/*/go']}") == []


def test_below_the_name_of_many_is_not_the_own_name() -> None:
    """`/r/*` are many nodes, each of which could act below the name of another."""
    assert messages("id: a, who: '/r/*', allow: {publish: ['/r/*/**']}") == [
        "rule a: publish on /r/*/** may move anything"
    ]
    assert messages("id: a, who: '/r/*', allow: {publish: ['{node}/**']}") == []


def test_a_denial_needs_a_reason_and_no_lifetime() -> None:
    text = "rossec: 1\nrobot: r\nrules:\n  - {id: d, who: /x, deny: {call: /b}}\n"
    assert [item.message for item in lint(policy(text), layout_of)] == ["rule d gives no reason"]


DENIED = "rule a: call /b never applies: it is always denied by rule no"


@pytest.mark.parametrize(
    ("allowed", "denial", "found"),
    [
        ("who: /x, allow: {call: /b}", "who: /x, deny: {call: /b}", [DENIED]),
        ("who: '/x/*', allow: {call: /b}", "who: '/x/**', deny: {call: '/*'}", [DENIED]),
        ("who: '/x/*', allow: {call: /b}", "who: /x/one, deny: {call: /b}", []),
        ("who: /x, allow: {call: '/*'}", "who: /x, deny: {call: /b}", []),
        ("who: /x, allow: {call: /b}", "who: '*', except: '/*', deny: {call: /b}", []),
        ("who: 'h:/x', allow: {call: /b}", "who: 'h:/**', deny: {call: /b}", [DENIED]),
        (
            "who: /x, allow: {provide: ~/b}",
            "who: '*', deny: {provide: ['/**']}",
            ["rule a: provide {node}/b never applies: it is always denied by rule no"],
        ),
        ("who: /x, allow: {provide: /x/b}", "who: '*', deny: {provide: ['~/b']}", []),
    ],
)
def test_what_another_rule_always_decides(allowed: str, denial: str, found: list[str]) -> None:
    assert messages(f"id: a, {allowed}", f"id: no, {denial}") == found


def test_a_denial_by_key_does_not_always_decide() -> None:
    head = f"identities: {{k: {{node: /x, key: 'sha256:{'ab' * 32}'}}}}\n"
    allowed = "id: a, who: /x, allow: {call: /b}"
    assert messages(allowed, "id: no, who: k, deny: {call: /b}", head=head) == []
    assert messages("id: a, who: k, allow: {call: /b}", "id: no, who: /x, deny: {call: /b}", head=head) == [
        DENIED
    ]


def test_a_type_for_own_names_is_used() -> None:
    types = {"{node}/p": "geometry_msgs/PoseStamped", "/a/*/q": "std_msgs/String"}
    used = "id: a, who: /x, allow: {publish: [~/p], subscribe: [/a/b/q]}"
    assert messages(used, types=types) == []
    assert messages("id: a, who: /x, allow: {call: /c}", types=types) == [
        "the type of /a/*/q is used by no rule",
        "the type of {node}/p is used by no rule",
    ]
