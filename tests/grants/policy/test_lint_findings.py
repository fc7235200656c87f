"""Codes are an interface: what is only form, and what a finding is for programs."""

from grants.policy.lint_findings import HARMLESS_CODES, LintFinding, Suggestion
from tests.grants.policy.lint_cases import CODES


def test_what_is_only_form_is_no_leak() -> None:
    assert CODES > HARMLESS_CODES
    assert not LintFinding(1, "no-reason", "m", "h").is_leak
    assert LintFinding(1, "no-rate", "m", "h").is_leak


def test_a_finding_for_programs() -> None:
    finding = LintFinding(3, "no-rate", "m", "h", (Suggestion("a", rate=1.0),))
    assert finding.as_json() == {"line": 3, "code": "no-rate", "message": "m", "hint": "h"}
    assert min(LintFinding(2, "a", "", ""), LintFinding(1, "b", "", "")).line == 1
