"""A small language for tests of lint: a policy from rules in one line each, and its codes.

The types of the topics that the rules name are added, and no others; `applied` makes the change
that a finding suggests, in the text of a policy.
"""

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from grants.filters.layout import Layout, parse
from grants.model import Right
from grants.policy.lint import lint
from grants.policy.lint_findings import LintFinding, Suggestion
from grants.policy.model import Policy
from grants.policy.source import Mistakes, Part, YamlMapping, YamlScalar, read_source
from tests.grants.policy.policies import definition, policy

TYPES = {
    "/pose": "geometry_msgs/PoseStamped",
    "/odom": "nav_msgs/Odometry",
    "/amcl_pose": "geometry_msgs/PoseWithCovarianceStamped",
    "/scan": "sensor_msgs/LaserScan",
    "/cloud": "sensor_msgs/PointCloud2",
    "/plan": "nav_msgs/Path",
    "/particles": "geometry_msgs/PoseArray",
    "/cmd_vel": "geometry_msgs/Twist",
    "/camera": "sensor_msgs/Image",
    "/camera2": "sensor_msgs/CompressedImage",
    "/fix": "sensor_msgs/NavSatFix",
    "/joints": "sensor_msgs/JointState",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/goal": "geometry_msgs/PoseStamped",
    "/map": "nav_msgs/OccupancyGrid",
    "/words": "std_msgs/String",
}
NO_REASON = "no reason: "
_SPEC = (Path(__file__).parents[3] / "docs" / "spec" / "policy.md").read_text().partition("| code |")[2]
"""The codes of the table in the specification."""
CODES = frozenset(re.findall(r"^\| ([a-z]+(?:-[a-z]+)+) \| [^|]+ \| [^|]+ \|$", _SPEC, re.MULTILINE))
HEADER = "rossec: 1\nrobot: test\ndefaults: {lifetime: 7d}\n"


def text_of(*lines: str, head: str = "", types: dict[str, str] | None = None) -> str:
    """A policy of these rules; what is the same in most of them is added."""
    rules = "".join(f"  - {{{_rule(line)}}}\n" for line in lines)
    named = {topic: kind for topic, kind in TYPES.items() if re.search(rf"(?<![\w*}}]){topic}\b", rules)}
    listed = json.dumps(named | (types or {}))
    return f"{HEADER}{head}types: {listed}\nrules:\n{rules}"


def _rule(line: str) -> str:
    """With a reason unless it says that it has none, and paths of arrays in quotes."""
    reason = "" if line.startswith(NO_REASON) else "why: w, "
    return reason + re.sub(r"([\w.]+\[\*\][\w.]*):", r'"\1":', line.removeprefix(NO_REASON))


def layout_of(kind: str) -> Layout:
    return parse(kind, definition(kind))


def findings(text: str) -> list[LintFinding]:
    return lint(policy(text), layout_of)


def codes(*lines: str, head: str = "", types: dict[str, str] | None = None) -> list[str]:
    """The codes of all advice on a policy of these rules, each once, sorted."""
    return sorted({item.code for item in findings(text_of(*lines, head=head, types=types))})


def messages(*lines: str, head: str = "", types: dict[str, str] | None = None) -> list[str]:
    return [item.message for item in findings(text_of(*lines, head=head, types=types))]


def applied(text: str, suggestions: Iterable[Suggestion]) -> str:
    """The policy `text` with the suggested changes, written as JSON, which is YAML."""
    document: dict[str, Any] = _value(read_source(text, Mistakes("x")))
    read = policy(text)
    for suggestion in suggestions:
        [rule] = [rule for rule in document["rules"] if rule["id"] == suggestion.rule]
        _change(rule, read, suggestion)
    document.pop("filters", None)  # written out where they are used
    return json.dumps(document)


def _change(rule: dict[str, Any], read: Policy, suggestion: Suggestion) -> None:
    if suggestion.without:
        listed = rule.pop("when")
        kept = [text for text in _listed(listed) if text != suggestion.without]
        rule |= {"when": kept} if kept else {}
    if suggestion.instead:
        for right, names in rule[_effect(rule)].items():
            rule[_effect(rule)][right] = [
                suggestion.instead if name == suggestion.topic else name for name in _listed(names)
            ]
    if suggestion.rate is not None:
        rule["limit"] = {"rate": suggestion.rate}
    if suggestion.treatment is not None:
        _write_filters(rule, read)
        treatment = suggestion.treatment
        parameters: Any = dict(treatment.parameters) or True
        fields = rule["filter"].setdefault(suggestion.topic, {})
        fields[treatment.path] = {treatment.operator: parameters}


def _effect(rule: dict[str, Any]) -> str:
    return next(key for key in ("allow", "prompt") if key in rule)


def _write_filters(rule: dict[str, Any], read: Policy) -> None:
    """Write the filters of a rule by topic and field, whatever form they had."""
    if any(key.startswith("/") for key in rule.get("filter", {})):
        return
    [meant] = [each for each in read.rules if each.id == rule["id"]]
    rule["filter"] = {
        clause.pattern: {
            item.path: {item.operator: dict(item.parameters) or True} for item in clause.restriction.filters
        }
        for clause in meant.clauses
        if clause.right is Right.SUBSCRIBE and clause.restriction and clause.restriction.filters
    }


def _listed(value: Any) -> list[str]:
    return value if isinstance(value, list) else [value]


def _value(part: Part | None) -> Any:
    match part:
        case YamlMapping():
            return {key: _value(value) for key, (_, value) in part.entries.items()}
        case YamlScalar():
            return part.value
        case None:
            return None
        case _:
            return [_value(item) for item in part.items]
