"""docs/spec/master.md lists the master's methods, rights and differences, as implemented."""

import re
from pathlib import Path

import pytest

from rossec.master.rights.access_rules import RULES
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import FakeStatements, master_api
from tests.rossec.master.test_differential import BY_NAME

SPEC = Path(__file__).parents[3] / "docs" / "spec"
PUSHES = {"rossec.revocationUpdate", "rossec.domainsUpdate", "rossec.foreignRevocationUpdate"}
MASTER = (SPEC / "master.md").read_text()


def rows(section: str) -> list[list[str]]:
    """The cells of the first table of a section, without its head."""
    text = MASTER.partition(f"\n## {section}\n")[2].partition("\n## ")[0]
    table = [line for line in text[text.index("|") :].split("\n\n")[0].splitlines() if line]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:]]


def test_every_difference_is_explained_and_every_explanation_is_of_one() -> None:
    explained = {name.strip("`"): cells for name, *cells in rows("5. Differences from stock")}
    assert explained.keys() == BY_NAME.keys()
    assert all(len(cells) == 3 and all(cells) for cells in explained.values())


def test_every_method_is_listed_with_its_right() -> None:
    listed = {name.strip("`"): (scope, right) for name, _, scope, right in rows("3. Methods")}
    assert listed == {
        method: (rule.scope.name.lower(), "" if rule.right is None else rule.right.label)
        for method, rule in RULES.items()
    }


@pytest.mark.parametrize("name", ["master.md", "revocation.md"])
def test_every_method_of_ours_that_is_named_exists(name: str) -> None:
    api = master_api(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)
    parameter_names = set(re.findall(r"rossec\.[a-z]+[A-Z]?\w+(?=[(`])", (SPEC / name).read_text()))
    assert len(parameter_names) > 4
    assert parameter_names - PUSHES <= api.methods.keys()


def test_every_method_with_a_rule_exists_and_the_other_way_round() -> None:
    api = master_api(Registry(), FakeStatements(), name="/master", uri="http://m:1/", pid=7)
    assert api.methods.keys() == RULES.keys()
