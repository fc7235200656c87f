"""Codes are an interface: their form, and what a finding is for programs."""

import re

from grants.policy.lint_findings import ADVICE, FORM, LintFinding, Suggestion


def test_codes_are_words_with_dashes() -> None:
    assert [code for code in ADVICE if not re.fullmatch(r"[a-z]+(-[a-z]+)+", code)] == []


def test_every_advice_says_what_and_what_to_do_in_one_line() -> None:
    for advice in ADVICE.values():
        for text in (advice.says, advice.do):
            assert 0 < len(text) < 140
            assert "\n" not in text
            assert "|" not in text  # a column of the table in the specification


def test_what_is_only_form_is_no_leak() -> None:
    assert ADVICE.keys() > FORM
    assert not LintFinding(1, "no-reason", "m", "h").is_leak
    assert LintFinding(1, "no-rate", "m", "h").is_leak


def test_a_finding_for_programs() -> None:
    finding = LintFinding(3, "no-rate", "m", "h", (Suggestion("a", rate=1.0),))
    assert finding.as_json() == {"line": 3, "code": "no-rate", "message": "m", "hint": "h"}
    assert min(LintFinding(2, "a", "", ""), LintFinding(1, "b", "", "")).line == 1
