"""Lint as a whole: seeded leaks are found, wise policies get no advice, advice can be followed."""

from functools import cache

import pytest

from grants.errors import GrantError, PolicyRefused
from grants.filters.compile import PRESETS
from grants.policy.lint import CHECKS, lint
from grants.policy.lint_findings import LintFinding
from grants.policy.model import SubjectPattern
from grants.vocabulary.contents import LEVELS
from tests.grants.policy.lint_cases import CODES, TYPES, applied, codes, findings, layout_of, text_of
from tests.grants.policy.lint_leaks import HOME, Leak
from tests.grants.policy.lint_leaks import LEAKS as OF_FIELDS
from tests.grants.policy.lint_leaks import WISE as OF_ALL
from tests.grants.policy.lint_leaks_related import RELATED, UNRELATED
from tests.grants.policy.policies import policy

LEAKS, WISE = (*OF_FIELDS, *RELATED), (*OF_ALL, *UNRELATED)


def of(leak: Leak) -> str:
    return text_of(*leak.rules, head=leak.head, types=dict(leak.types))


def found_in(text: str) -> set[tuple[str, str]]:
    return {(item.code, item.message) for item in findings(text)}


@pytest.mark.parametrize("leak", LEAKS, ids=lambda leak: leak.name)
def test_each_seeded_leak_is_found_and_nothing_else(leak: Leak) -> None:
    assert sorted({item.code for item in findings(of(leak))}) == leak.codes.split()


@pytest.mark.parametrize("leak", WISE, ids=lambda leak: leak.name)
def test_a_wise_policy_gets_no_advice(leak: Leak) -> None:
    assert [item.message for item in findings(of(leak))] == []


def test_a_home_with_a_robot_a_doctor_a_heating_a_guest_and_rviz() -> None:
    assert [item.message for item in findings(HOME)] == []
    with_tf = findings(HOME.replace("basics: true", "basics: [tf]"))
    assert {item.code for item in with_tf} == {"exact-relative"}  # whatever they see coarsely
    assert len(with_tf) == 3


def test_every_code_of_the_specification_is_given_by_a_seeded_leak() -> None:
    given = {code for leak in LEAKS for code in leak.codes.split()}
    assert given == CODES - {"no-lifetime"}
    assert len(LEAKS) > 29


def test_no_lifetime() -> None:
    text = text_of("id: a, who: /x, allow: {call: /b}").replace("defaults: {lifetime: 7d}\n", "")
    assert [item.code for item in findings(text)] == ["no-lifetime"]


@cache
def with_suggestions() -> list[tuple[str, LintFinding]]:
    return [(of(leak), item) for leak in LEAKS for item in findings(of(leak)) if item.suggestions]


def test_what_is_suggested_is_a_policy_in_which_the_leak_is_gone() -> None:
    """`policy` reads the changed text as `rossec policy check` does, or raises."""
    tried = with_suggestions()
    for text, finding in tried:
        changed = applied(text, finding.suggestions)
        policy(changed)
        assert (finding.code, finding.message) not in found_in(changed)
    assert len(tried) > 29


@pytest.mark.parametrize("leak", LEAKS, ids=lambda leak: leak.name)
def test_all_suggestions_can_be_followed_together(leak: Leak) -> None:
    text = of(leak)
    suggestions = [each for item in findings(text) for each in item.suggestions]
    changed = applied(text, suggestions)
    policy(changed)
    suggested = {item.code for item in findings(text) if item.suggestions}
    assert suggested.isdisjoint(item.code for item in findings(changed))


def test_a_suggested_treatment_is_in_the_hint() -> None:
    for _, finding in with_suggestions():
        for each in finding.suggestions:
            if each.treatment is not None and "use:" not in finding.hint:
                assert each.treatment.path in finding.hint


def supported(name: str) -> list[str]:
    """A topic of each type that the preset supports."""
    found = {}
    for topic, kind in TYPES.items():
        try:
            PRESETS[name].restriction(layout_of(kind))
        except GrantError:
            continue
        found[kind] = topic
    return list(found.values())


@pytest.mark.parametrize("name", PRESETS)
def test_no_preset_gets_advice(name: str) -> None:
    topics = supported(name)
    assert topics
    for topic in topics:
        rule = f"id: a, who: /x, allow: {{subscribe: [{topic}]}}, filter: {{use: {name}}}"
        assert codes(rule) == [], topic


SAID = [
    (word, level, topic)
    for word, levels in LEVELS.items()
    for level in levels[1:]
    for topic in ("/pose", "/odom", "/fix", "/camera", "/scan", "/joints", "/diagnostics")
]


def test_no_level_gets_advice() -> None:
    """A level is what `see` says: what gives it away in the same message is treated with it."""
    given = 0
    for word, level, topic in SAID:
        text = text_of(f"id: a, who: /x, allow: {{subscribe: [{topic}]}}, see: {{{word}: {level}}}")
        try:
            policy(text)
        except PolicyRefused:  # the type does not tell the word
            continue
        given += 1
        assert [item.message for item in findings(text)] == [], (word, level, topic)
    assert given > 29


def test_the_same_advice_is_given_once_and_in_the_order_of_the_file() -> None:
    found = findings(
        text_of(*(line for leak in LEAKS[:3] for line in leak.rules), types={})
        .replace("id: a", "id: b", 1)
        .replace("id: a", "id: c", 1)
    )
    assert [item.line for item in found] == sorted(item.line for item in found)
    assert len({(item.code, item.message) for item in found}) == len(found)


def test_a_policy_without_rules_gets_no_advice() -> None:
    assert lint(policy("rossec: 1\nrobot: r\nrules: []\n"), layout_of) == []


def test_checks_are_a_table() -> None:
    assert len(set(CHECKS)) == len(CHECKS)
    assert SubjectPattern("*", "/**").sample.name == "/x"
