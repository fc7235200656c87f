"""The files that are shipped are there, and are what they say."""

import pytest

from rossec.naming import requests, rule_runner
from rossec.naming.requests import check_rules


def test_the_rules_are_there() -> None:
    assert b"<parameter name=" in check_rules(rule_runner.shipped_rules())


@pytest.mark.parametrize("name", ["phone.xml"])
def test_the_examples_are_metadata(name: str) -> None:
    assert requests.read(rule_runner.shipped_example(name)).entries
