"""The JSON Schema of a policy for editors: structure and keys, not message types.

`python -m tools.schema` writes `grants/policy/policy.schema.json` again when operators or rights change.
"""

import json
from pathlib import Path
from typing import Any, Final

from grants.filters.operators import OPERATORS
from grants.limits import MAX_PAD, MAX_SLOT, MIN_PAD, MIN_SLOT
from grants.policy import read
from grants.policy.assertions import NOTHING, Says
from grants.policy.model import SAYABLE
from grants.policy.read import MAX_TITLE
from grants.policy.rules import EXTRAS, RIGHTS
from grants.vocabulary.contents import LEVELS

FILE: Final = Path(read.__file__).with_name("policy.schema.json")
_NAME: Final = r"[A-Za-z][A-Za-z0-9_]*"
_SEGMENT: Final = rf"(?:{_NAME}|\*\*?)"
_PATTERN: Final = {"type": "string", "pattern": rf"^(?:/{_SEGMENT})+$"}
_OWN_NAMES: Final = rf"\{{node\}}(?:/{_SEGMENT})*|~(?:/{_SEGMENT})+"
_RULE_PATTERN: Final = {"type": "string", "pattern": rf"^(?:(?:/{_SEGMENT})+|{_OWN_NAMES})$"}
_TOPIC: Final = r"^(?:/|~/|\{node\})"
_FIELD: Final = rf"^{_NAME}(?:\[\*\])?(?:\.{_NAME}(?:\[\*\])?)*$"
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


def _named(item: dict[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": item, "propertyNames": names}


def _by(pattern: str, item: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "patternProperties": {pattern: item}, "additionalProperties": False}


def _rule() -> dict[str, Any]:
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
            "filter": {"anyOf": [plain, _by(_TOPIC, plain)]},
            "see": {"anyOf": [{"$ref": "#/$defs/see"}, _by(_TOPIC, {"$ref": "#/$defs/see"})]},
            "limit": _LIMIT,
            "on_stale": {"enum": ["cut", "keep"]},
            "lifetime": _DURATION,
            "renew_until": _RENEW,
        },
        "id",
        "who",
    )
    restricting = ("when", "filter", "see", "limit", "on_stale", "lifetime", "renew_until")
    unrestricted: dict[str, Any] = {"properties": dict.fromkeys(restricting, False)}
    return {
        **rule,
        "oneOf": [{"required": [effect]} for effect in effects],
        "if": {"required": ["deny"]},
        "then": unrestricted,
    }


def schema() -> dict[str, Any]:
    rights = {**_object({right: _one_or_many(_RULE_PATTERN) for right in RIGHTS}), "minProperties": 1}
    identity = _object({"node": _PATTERN, "key": {"type": "string", "pattern": "^sha256:[0-9a-f]{64}$"}})
    defaults = _object(
        {
            "decision": {"enum": ["deny", "prompt"]},
            "lifetime": _DURATION,
            "renew_until": _RENEW,
            "prompt_timeout": _DURATION,
        }
    )
    types = {"type": "string", "pattern": f"^{_NAME}/{_NAME}$"}
    limit = {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, _TEXT]}
    seen = {"type": "object", "additionalProperties": limit, "minProperties": 1}
    test = _object(
        {
            "who": _TEXT,
            **{says.value: {"$ref": "#/$defs/rights"} for says in Says},
            "sees": _by(_TOPIC, {"anyOf": [{"const": NOTHING}, seen]}),
            "at": _one_or_many({"type": "string", "format": "date-time"}),
            "message": {"type": "object"},
        },
        "who",
    )
    title = {"type": "string", "minLength": 1, "maxLength": MAX_TITLE, "pattern": "^[^/]*$"}
    said_of = {"pattern": rf"^(?:{_NAME}/{_NAME}|(?:/{_SEGMENT})+|{_OWN_NAMES})$"}
    extras = {"type": "array", "items": {"enum": sorted(EXTRAS)}, "minItems": 1}
    operator = _object(dict.fromkeys(sorted(OPERATORS), True))
    levels = {word.value: {"enum": list(names)} for word, names in LEVELS.items()}
    top = _object(
        {
            "rossec": {"const": 1},
            "robot": _TEXT,
            "defaults": defaults,
            "basics": {"anyOf": [{"type": "boolean"}, extras]},
            "identities": _named({**identity, "minProperties": 1}, {"pattern": "^[^/*]"}),
            "groups": _named(_one_or_many(_TEXT), {"pattern": "^(?!node$)[A-Za-z][A-Za-z0-9_-]{0,79}$"}),
            "types": _named(types, _RULE_PATTERN),
            "vocabulary": _named(_by(_FIELD, {"enum": sorted(SAYABLE)}), said_of),
            "rooms": {"type": "object", "additionalProperties": _TEXT, "minProperties": 1},
            "filters": {"type": "object", "additionalProperties": {"$ref": "#/$defs/fields"}},
            "rules": {"type": "array", "items": {"$ref": "#/$defs/rule"}},
            "tests": {"type": "array", "items": {"$ref": "#/$defs/test"}},
            "title": {"type": "object", "additionalProperties": title},
        },
        "rossec",
        "robot",
        "rules",
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "rossec policy",
        "$defs": {
            "operator": {**operator, "minProperties": 1, "maxProperties": 1},
            "fields": _by(_FIELD, {"$ref": "#/$defs/operator"}),
            "see": {**_object(levels), "minProperties": 1},
            "rights": rights,
            "rule": _rule(),
            "test": test,
        },
        **top,
    }


def schema_text() -> str:
    return json.dumps(schema(), indent=2) + "\n"


if __name__ == "__main__":
    FILE.write_text(schema_text())
