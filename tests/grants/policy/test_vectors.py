"""The vectors of policies: rules, and the scope of the resulting grant; None: refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from ca.encoding import decode
from grants.document import from_draft
from grants.model import Draft, Right
from grants.policy.model import Subject
from grants.policy.wanted import drafts
from tests.grants.authority import NOW
from tests.grants.policy.policies import decide, mistakes, node, rules

FOLDER = Path(__file__).parents[2] / "vectors" / "policy"
VECTORS: list[dict[str, Any]] = json.loads((FOLDER / "on_stale.json").read_text())
OWN_NAMES: list[dict[str, Any]] = json.loads((FOLDER / "own_names.json").read_text())
X = node("/x")


def scope(draft: Draft) -> Any:
    claims: Any = from_draft(draft, bytes(32))
    return json.loads(json.dumps(decode(claims[9])))


def test_the_number_of_vectors() -> None:
    assert len(VECTORS) >= 8
    assert len(OWN_NAMES) >= 16


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_on_stale_of_rules_in_the_grant(vector: dict[str, Any]) -> None:
    if vector["scope"] is None:
        assert mistakes(*vector["rules"])
        return
    verdict = decide(rules(*vector["rules"]), X, Right.SUBSCRIBE, "/stop")
    (draft,) = drafts([verdict], domain="home", now=NOW, serial=lambda: bytes(16))
    assert scope(draft) == vector["scope"]


@pytest.mark.parametrize("vector", OWN_NAMES, ids=lambda vector: vector["name"])
def test_own_names_in_the_grant(vector: dict[str, Any]) -> None:
    """`scope` is empty where the request is not allowed."""
    if vector["scope"] is None:
        assert mistakes("rossec: 1\nrobot: r\nrules: [" + ", ".join(vector["rules"]) + "]\n")
        return
    subject = Subject(vector["node"], bytes(32), vector["tail"])
    verdict = decide(rules(*vector["rules"]), subject, Right(vector["right"]), vector["asked"])
    made = drafts([verdict], domain="home", now=NOW, serial=lambda: bytes(16)) if verdict else []
    assert [entry for each in made for entry in scope(each)] == vector["scope"]
