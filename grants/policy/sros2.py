"""Conversion of SROS2 policies (XML). What cannot be converted is reported, never guessed.

Read: `policy/enclaves/enclave/profiles/profile(ns, node)` with `topics`, `services` and `actions`
(design article "ROS 2 access control policies"). DTDs are refused before anything in them is
read. SROS2 matches with fnmatch; only whole segments of `*` are supported here.
"""

import io
from collections import Counter
from collections.abc import Iterator
from typing import Any, Final
from xml.etree.ElementTree import ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from ca.errors import PatternRefused
from grants.errors import PolicyRefused
from grants.policy.editing import NewRule, add_rules, empty, free_id
from grants.policy.own_names import NODE, check_rule_pattern

MAX_SIZE: Final = 4 * 1024 * 1024
MAX_PARTS: Final = 20_000
MAX_DEPTH: Final = 16
_KINDS: Final[dict[str, tuple[str, dict[str, tuple[str, ...]]]]] = {
    "topics": ("topic", {"publish": ("publish",), "subscribe": ("subscribe",)}),
    "services": ("service", {"reply": ("provide",), "request": ("call",)}),
    "actions": ("action", {"execute": (), "call": ()}),
}
# An action of ROS 1 is five topics: what the client publishes, and what the server does.
_GOALS: Final = ("goal", "cancel")
_RESULTS: Final = ("status", "feedback", "result")
_ROS2_ONLY: Final = ("parameter_events", "describe_parameters", "get_parameter_types",
                     "get_parameters", "list_parameters", "set_parameters",
                     "set_parameters_atomically", "get_type_description")  # fmt: skip


def import_sros2(xml: str) -> tuple[str, list[str]]:
    """A policy text, and the parts of the XML that are not in it, one line each.

    Raises:
        PolicyRefused: not XML, XML with a DTD, or not an SROS2 policy.
    """
    root = _parse(xml)
    notes: list[str] = []
    rules: list[NewRule] = []
    taken: set[str] = set()
    repeated: Counter[str] = Counter()
    for profile in root.iter("profile"):
        for rule in _profile(profile, notes):
            repeated[rule.id] += 1
            duplicate = repeated[rule.id] > 1
            name = free_id(taken, f"{rule.id}-{repeated[rule.id]}" if duplicate else rule.id)
            taken.add(name)
            rules.append(NewRule(name, rule.why, rule.who, rule.effect, rule.rights))
    notes += [f"{item.tag} is not followed" for item in root.iter() if "include" in str(item.tag)]
    if not rules:
        raise PolicyRefused("no profile in this policy has rules", "is it an SROS2 policy?")
    return add_rules(empty("imported"), rules), notes


def _parse(xml: str) -> Any:
    if len(xml) > MAX_SIZE:
        raise PolicyRefused(f"{len(xml)} characters where at most {MAX_SIZE} are allowed")
    try:
        root = _bounded(xml)
    except DefusedXmlException as error:
        raise PolicyRefused("a policy with a DTD is refused", "remove the DOCTYPE") from error
    except (ParseError, ValueError) as error:
        raise PolicyRefused(f"not XML: {error}", "is it an SROS2 policy?") from error
    if root.tag != "policy":
        raise PolicyRefused(f"not an SROS2 policy but {str(root.tag)[:60]!r}", "<policy> expected")
    return root


def _bounded(xml: str) -> Any:
    """The root; the cost of a tree is in its elements and attributes, so they are counted first."""
    root, depth, count = None, 0, 0
    data = io.BytesIO(xml.encode(errors="replace"))
    for event, element in iterparse(data, events=("start", "end"), forbid_dtd=True):
        root = element if root is None else root
        depth += 1 if event == "start" else -1
        count += (1 + len(element.attrib)) if event == "start" else 0
        if depth > MAX_DEPTH or count > MAX_PARTS:
            raise PolicyRefused(
                f"more than {MAX_PARTS} elements and attributes, or deeper than {MAX_DEPTH}",
                "import it in parts",
            )
    return root


def _profile(profile: Any, notes: list[str]) -> Iterator[NewRule]:
    """The rules of one node: allowed and denied rights."""
    namespace = "/" + profile.get("ns", "/").strip("/")
    node = f"{namespace.rstrip('/')}/{profile.get('node', '').strip('/')}"
    if not _is_pattern(node):
        notes.append(f"profile {node}: not a node name or pattern")
        return
    rights: dict[str, dict[str, dict[str, None]]] = {"allow": {}, "deny": {}}
    for tag, (child, labels) in _KINDS.items():
        for group in profile.findall(tag):
            for attribute, names in labels.items():
                effect = {"ALLOW": "allow", "DENY": "deny"}.get(group.get(attribute, ""))
                if effect is None:
                    continue
                for item in group.findall(child):
                    pattern = _resolve((item.text or "").strip(), namespace)
                    _add(rights[effect], attribute, names, pattern, node, notes)
    for effect, found in rights.items():
        if found:
            name = f"{'sros2' if effect == 'allow' else 'sros2-deny'}{node.replace('/', '-')}"
            clean = name.replace("*", "any")[:70]
            yield NewRule(clean, "imported from SROS2; review me", node, effect, found)


def _add(
    rights: dict[str, dict[str, None]], attribute: str, labels: tuple[str, ...],
    pattern: str, node: str, notes: list[str],
) -> None:  # fmt: skip
    if pattern.rsplit("/", 1)[-1] in _ROS2_ONLY:
        notes.append(f"{node}: {pattern} exists in ROS 2 only")
        return
    if not _is_pattern(pattern):
        notes.append(f"{node}: {attribute} {pattern} is not a pattern of whole segments")
        return
    for label, name in _rights(attribute, labels, pattern):
        rights.setdefault(label, {})[name] = None


def _rights(attribute: str, labels: tuple[str, ...], name: str) -> list[tuple[str, str]]:
    if labels:
        return [(label, name) for label in labels]
    server = attribute == "execute"
    goals = [("subscribe" if server else "publish", f"{name}/{part}") for part in _GOALS]
    return goals + [("publish" if server else "subscribe", f"{name}/{part}") for part in _RESULTS]


def _resolve(name: str, namespace: str) -> str:
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        return f"{NODE}/{name[1:].lstrip('/')}"
    return f"{namespace.rstrip('/')}/{name}"


def _is_pattern(text: str) -> bool:
    try:
        check_rule_pattern(text)
    except PatternRefused:
        return False
    return True
