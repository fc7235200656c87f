from rossec.naming import rule_runner
from tests.support.commands import Shell


def test_the_rules_that_are_shipped_as_they_are(empty: Shell) -> None:
    assert empty("namespace", "rules").out.encode() == rule_runner.shipped_rules()
