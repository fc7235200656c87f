"""The JSON Schema of a policy, for editors: completion and errors while typing. Pure.

It covers the structure and the keys, not the message types; `rossec policy check` covers all.
`policy.schema.json` beside this module is its text; a test compares the two.
"""

import json
from typing import Any, Final

from grants.filters.operators import OPERATORS
from grants.limits import MAX_PAD, MAX_SLOT, MIN_PAD, MIN_SLOT
from grants.policy.assertions import NOTHING, Says
from grants.policy.basics import EXTRAS
from grants.policy.rules import RIGHTS
from grants.policy.titles import MAX_TITLE
from grants.policy.vocabulary import SAYABLE
from grants.vocabulary.words import LEVELS

_NAME: Final = r"[A-Za-z][A-Za-z0-9_]*"
_SEGMENT: Final = rf"(?:{_NAME}|\*\*?)"
_PATTERN: Final = {"type": "string", "pattern": rf"^(?:/{_SEGMENT})+$"}
_OWN_NAMES: Final = rf"\{{node\}}(?:/{_SEGMENT})*|~(?:/{_SEGMENT})+"
_RULE_PATTERN: Final = {"type": "string", "pattern": rf"^(?:(?:/{_SEGMENT})+|{_OWN_NAMES})$"}
_TOPIC: Final = r"^(?:/|~/|\{node\})"
_DURATION: Final = {"type": "string", "pattern": "^[1-9][0-9]{0,5}[smhdw]$"}
_RENEW: Final = {"anyOf": [_DURATION, {"const": "never"}]}
_TEXT: Final = {"type": "string", "minLength": 1, "maxLength": 1000}

_LIMIT: Final = {
    "type": "object",
    "properties": {
        "rate": {"type": "number", "exclusiveMinimum": 0},
        "slot": {"type": "integer", "minimum": MIN_SLOT, "maximum": MAX_SLOT},
        "body": {"type": "string", "pattern": "^[A-Za-z][A-Za-z0-9_-]{0,63}$"},
        "pad": {"type": "integer", "minimum": MIN_PAD, "maximum": MAX_PAD},
    },
    "minProperties": 1,
    "additionalProperties": False,
}


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


def _see() -> dict[str, Any]:
    levels = {word.value: {"enum": list(names)} for word, names in LEVELS.items()}
    return {**_object(levels), "minProperties": 1}


def _vocabulary() -> dict[str, Any]:
    path = rf"^{_NAME}(?:\[\*\])?(?:\.{_NAME}(?:\[\*\])?)*$"
    fields = {
        "type": "object",
        "patternProperties": {path: {"enum": sorted(SAYABLE)}},
        "additionalProperties": False,
    }
    names = {"pattern": rf"^(?:{_NAME}/{_NAME}|(?:/{_SEGMENT})+|{_OWN_NAMES})$"}
    return {"type": "object", "additionalProperties": fields, "propertyNames": names}


def _by_topic(item: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "patternProperties": {_TOPIC: item}, "additionalProperties": False}


def _rule() -> dict[str, Any]:
    rights = {
        **_object({right: _one_or_many(_RULE_PATTERN) for right in RIGHTS}),
        "minProperties": 1,
    }
    use = _object({"use": _TEXT}, "use")
    plain = {"anyOf": [use, {"$ref": "#/$defs/fields"}]}
    effects = ("allow", "deny", "prompt")
    rule = _object(
        {
            "id": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9_.-]{0,79}$"},
            "why": _TEXT,
            "who": _one_or_many(_TEXT),
            "except": _one_or_many(_TEXT),
            **{effect: {"$ref": "#/$defs/rights"} for effect in effects},
            "when": _one_or_many(_TEXT),
            "filter": {"anyOf": [plain, _by_topic(plain)]},
            "see": {"anyOf": [{"$ref": "#/$defs/see"}, _by_topic({"$ref": "#/$defs/see"})]},
            "limit": _LIMIT,
            "on_stale": {"enum": ["cut", "keep"]},
            "lifetime": _DURATION,
            "renew_until": _RENEW,
        },
        "id", "who",
    )  # fmt: skip
    restricting = ("when", "filter", "see", "limit", "on_stale", "lifetime", "renew_until")
    unrestricted: dict[str, Any] = {"properties": dict.fromkeys(restricting, False)}
    return {
        "$defs": {"rights": rights},
        **rule,
        "oneOf": [{"required": [effect]} for effect in effects],
        "if": {"required": ["deny"]},
        "then": unrestricted,
    }


def _test() -> dict[str, Any]:
    limit = {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, _TEXT]}
    fields = {"type": "object", "additionalProperties": limit, "minProperties": 1}
    seen = {"anyOf": [{"const": NOTHING}, fields]}
    rights = {"$ref": "#/$defs/rights"}
    return _object(
        {
            "who": _TEXT,
            **{says.value: rights for says in Says},
            "sees": {
                "type": "object",
                "patternProperties": {_TOPIC: seen},
                "additionalProperties": False,
            },
            "at": _one_or_many({"type": "string", "format": "date-time"}),
            "message": {"type": "object"},
        },
        "who",
    )


def _titles() -> dict[str, Any]:
    title = {"type": "string", "minLength": 1, "maxLength": MAX_TITLE, "pattern": "^[^/]*$"}
    return {"type": "object", "additionalProperties": title}


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
            "basics": {
                "anyOf": [
                    {"type": "boolean"},
                    {"type": "array", "items": {"enum": sorted(EXTRAS)}, "minItems": 1},
                ]
            },
            "identities": {
                "type": "object",
                "additionalProperties": {**identity, "minProperties": 1},
                "propertyNames": {"pattern": "^[^/*]"},
            },
            "groups": {
                "type": "object",
                "additionalProperties": _one_or_many(_TEXT),
                "propertyNames": {"pattern": "^(?!node$)[A-Za-z][A-Za-z0-9_-]{0,79}$"},
            },
            "types": {
                "type": "object",
                "additionalProperties": types,
                "propertyNames": _RULE_PATTERN,
            },
            "vocabulary": _vocabulary(),
            "rooms": {"type": "object", "additionalProperties": _TEXT, "minProperties": 1},
            "filters": {"type": "object", "additionalProperties": {"$ref": "#/$defs/fields"}},
            "rules": {"type": "array", "items": {"$ref": "#/$defs/rule"}},
            "tests": {"type": "array", "items": {"$ref": "#/$defs/test"}},
            "title": _titles(),
        },
        "rossec", "robot", "rules",
    )  # fmt: skip
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "rossec policy",
        "$defs": {
            "operator": _operator(), "fields": _fields(), "see": _see(), "rights": rights,
            "rule": rule, "test": _test(),
        },
        **top,
    }  # fmt: skip


def text() -> str:
    """The schema as the text of the file."""
    return json.dumps(schema(), indent=2) + "\n"
