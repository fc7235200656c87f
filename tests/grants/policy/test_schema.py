"""The schema for editors: accepts the examples, refuses the mistakes it can detect."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from ruamel.yaml import YAML

from grants.filters.operators import OPERATORS
from tests.grants.policy.policies import SMALL
from tests.grants.policy.test_seeds import GOOD, SEEDS
from tools import schema

EXAMPLES = sorted((Path(__file__).parents[3] / "examples" / "policies").glob("*.yaml"))
# Mistakes that need the identities, the types and the operators' parameters.
NOT_DETECTED = {"field": 7, "operator": 0, "identity": 7, "key": 0, "duration": 0, "pattern": 1, "type": 6}


def check(text: str) -> list[str]:
    validator = jsonschema.Draft202012Validator(schema.schema())
    return [error.message for error in validator.iter_errors(YAML(typ="safe").load(text))]


def test_the_file_has_the_schema() -> None:
    assert schema.FILE.read_text() == schema.schema_text(), "run: python -m tools.schema"
    jsonschema.Draft202012Validator.check_schema(json.loads(schema.schema_text()))


@pytest.mark.parametrize("text", [SMALL, GOOD])
def test_valid_policies_pass(text: str) -> None:
    assert check(text) == []


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_examples_pass(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = dict.fromkeys((*OPERATORS, "hash", "pixelate"))
    monkeypatch.setattr(schema, "OPERATORS", every)
    assert check(path.read_text()) == []


@pytest.mark.parametrize("kind", SEEDS)
def test_inserted_mistakes_are_detected(kind: str) -> None:
    seen = [check(GOOD.replace(there, planted, 1)) != [] for there, planted, *_ in SEEDS[kind]]
    assert len(seen) - sum(seen) == NOT_DETECTED[kind]


def test_a_denial_has_no_filter() -> None:
    deny: dict[str, Any] = {"id": "a", "who": "x", "deny": {"call": "/b"}}
    validator = jsonschema.Draft202012Validator(schema.schema())
    policy = {"rossec": 1, "robot": "r", "rules": [deny]}
    assert validator.is_valid(policy)
    deny["lifetime"] = "1d"
    assert not validator.is_valid(policy)


@pytest.mark.parametrize(
    ("more", "is_valid"),
    [
        ("basics: true", True),
        ("basics: [tf]", True),
        ("basics: yes", False),
        ("basics: [odom]", False),
        ("tests: [{who: /a, may: {call: /s}, may_not: {publish: /**}, asks: {call: [/t]}}]", True),
        ("tests: [{who: /a, sees: {/t: {x.y: 2.0, z: no}, /u: no}, at: x, message: {}}]", True),
        ("tests: [{may: {call: /s}}]", False),
        ("tests: [{who: /a, sees: {/t: 2}}]", False),
        ("tests: [{who: /a, may: {dance: /s}}]", False),
    ],
)
def test_basics_and_tests(more: str, *, is_valid: bool) -> None:
    assert (check(f"rossec: 1\nrobot: r\nrules: []\n{more}\n") == []) is is_valid


@pytest.mark.parametrize(
    ("name", "valid"),
    [
        ("{node}", True),
        ("{node}/pose", True),
        ("~/pose", True),
        ("~/**", True),
        ("/a/*", True),
        ("~", False),
        ("~pose", False),
        ("{nod}/x", False),
        ("/a/{node}", False),
        ("~/", False),
        ("{node}x", False),
        ("/a~/b", False),
    ],
)
def test_own_names_stand_first(name: str, valid: bool) -> None:
    rule = {"id": "a", "who": "robots", "allow": {"call": name}}
    policy = {"rossec": 1, "robot": "r", "groups": {"robots": ["/a", "b"]}, "rules": [rule]}
    assert jsonschema.Draft202012Validator(schema.schema()).is_valid(policy) is valid
