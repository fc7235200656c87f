"""The JSON Schema of a policy, for editors: completion and errors while typing. Pure.

It covers the structure and the keys, not the message types; `rossec policy check` covers all.
`policy.schema.json` beside this module is its text; a test compares the two.
"""

import json
from typing import Any, Final

from grants.filters.operators import OPERATORS
from grants.policy.rules import RIGHTS

_NAME: Final = r"[A-Za-z][A-Za-z0-9_]*"
_SEGMENT: Final = rf"(?:{_NAME}|\*\*?)"
_PATTERN: Final = {"type": "string", "pattern": rf"^(?:/{_SEGMENT})+$"}
_DURATION: Final = {"type": "string", "pattern": "^[1-9][0-9]{0,5}[smhdw]$"}
_RENEW: Final = {"anyOf": [_DURATION, {"const": "never"}]}
_TEXT: Final = {"type": "string", "minLength": 1, "maxLength": 1000}


def _object(properties: dict[str, Any], *required: str) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(required),
        "additionalProperties": False,
    }


def _one_or_many(item: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [item, {"type": "array", "items": item, "minItems": 1}]}


def _operator() -> dict[str, Any]:
    found = _object(dict.fromkeys(sorted(OPERATORS), True))
    return {**found, "minProperties": 1, "maxProperties": 1}


def _fields() -> dict[str, Any]:
    path = rf"^{_NAME}(?:\[\*\])?(?:\.{_NAME}(?:\[\*\])?)*$"
    return {
        "type": "object",
        "patternProperties": {path: {"$ref": "#/$defs/operator"}},
        "additionalProperties": False,
    }


def _rule() -> dict[str, Any]:
    rights = {**_object({right: _one_or_many(_PATTERN) for right in RIGHTS}), "minProperties": 1}
    use = _object({"use": _TEXT}, "use")
    plain = {"anyOf": [use, {"$ref": "#/$defs/fields"}]}
    topics = {
        "type": "object", "patternProperties": {"^/": plain}, "additionalProperties": False,
    }  # fmt: skip
    effects = ("allow", "deny", "prompt")
    rule = _object(
        {
            "id": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9_.-]{0,79}$"},
            "why": _TEXT,
            "who": _one_or_many(_TEXT),
            "except": _one_or_many(_TEXT),
            **{effect: {"$ref": "#/$defs/rights"} for effect in effects},
            "when": _one_or_many(_TEXT),
            "filter": {"anyOf": [plain, topics]},
            "limit": _object({"rate": {"type": "number", "exclusiveMinimum": 0}}, "rate"),
            "on_stale": {"enum": ["cut", "keep"]},
            "lifetime": _DURATION,
            "renew_until": _RENEW,
        },
        "id", "who",
    )  # fmt: skip
    restricting = ("when", "filter", "limit", "on_stale", "lifetime", "renew_until")
    unrestricted: dict[str, Any] = {"properties": dict.fromkeys(restricting, False)}
    return {
        "$defs": {"rights": rights},
        **rule,
        "oneOf": [{"required": [effect]} for effect in effects],
        "if": {"required": ["deny"]},
        "then": unrestricted,
    }


def schema() -> dict[str, Any]:
    """The schema, for the operators of this version."""
    rule = _rule()
    rights = rule.pop("$defs")["rights"]
    identity = _object(
        {"node": _PATTERN, "key": {"type": "string", "pattern": "^sha256:[0-9a-f]{64}$"}}
    )
    defaults = _object(
        {
            "decision": {"enum": ["deny", "prompt"]},
            "lifetime": _DURATION,
            "renew_until": _RENEW,
            "prompt_timeout": _DURATION,
        }
    )
    types = {"type": "string", "pattern": f"^{_NAME}/{_NAME}$"}
    top = _object(
        {
            "rossec": {"const": 1},
            "robot": _TEXT,
            "defaults": defaults,
            "identities": {
                "type": "object",
                "additionalProperties": {**identity, "minProperties": 1},
                "propertyNames": {"pattern": "^[^/*]"},
            },
            "types": {
                "type": "object",
                "additionalProperties": types,
                "propertyNames": _PATTERN,
            },
            "filters": {"type": "object", "additionalProperties": {"$ref": "#/$defs/fields"}},
            "rules": {"type": "array", "items": {"$ref": "#/$defs/rule"}},
        },
        "rossec", "robot", "rules",
    )  # fmt: skip
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "rossec policy",
        "$defs": {"operator": _operator(), "fields": _fields(), "rights": rights, "rule": rule},
        **top,
    }


def text() -> str:
    """The schema as the text of the file."""
    return json.dumps(schema(), indent=2) + "\n"
