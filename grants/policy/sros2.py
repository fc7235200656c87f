"""Conversion of SROS2 policies (XML): kept exactly, or narrower and said, or refused.

Read: `policy/enclaves/enclave/profiles/profile(ns, node)` with `topics`, `services` and `actions` (design
article "ROS 2 access control policies"). What is allowed may become narrower or be left out, and is reported;
what is denied is kept as wide as it is, or the policy is refused, as is one with parts that are not read:
they may deny.
"""

import io
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple
from xml.etree.ElementTree import ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import iterparse

from ca.errors import PatternRefused
from grants.errors import PolicyRefused
from grants.policy.learn import NewRule, add_rules, empty, free_id
from grants.policy.names import NODE, check_rule_pattern

VERSION: Final = "0.2.0"
MAX_SIZE: Final = 4 * 1024 * 1024
MAX_PARTS: Final = 20_000
MAX_DEPTH: Final = 16
_KINDS: Final[dict[str, tuple[str, dict[str, tuple[str, ...]]]]] = {
    "topics": ("topic", {"publish": ("publish",), "subscribe": ("subscribe",)}),
    "services": ("service", {"reply": ("provide",), "request": ("call",)}),
    "actions": ("action", {"execute": (), "call": ()}),
}
_READ: Final = "read: "  # begins a note about what is in the policy, unlike what is left out
_DEFAULT: Final = "default"
_ITEMS: Final = {child: frozenset[str]() for child, _ in _KINDS.values()}
_ATTRIBUTES: Final[dict[str, frozenset[str]]] = {
    "policy": frozenset({"version"}),
    "enclaves": frozenset(),
    "enclave": frozenset({"path"}),
    "profiles": frozenset(),
    "profile": frozenset({"ns", "node"}),
    **{tag: frozenset(labels) for tag, (_, labels) in _KINDS.items()},
    **_ITEMS,
}
_BELOW: Final[dict[str, frozenset[str]]] = {
    "policy": frozenset({"enclaves"}),
    "enclaves": frozenset({"enclave"}),
    "enclave": frozenset({"profiles"}),
    "profiles": frozenset({"profile"}),
    "profile": frozenset(_KINDS),
    **{tag: frozenset({child}) for tag, (child, _) in _KINDS.items()},
    **_ITEMS,
}
# An action of ROS 1 is five topics: what the client publishes, and what the server does.
_GOALS: Final = ("goal", "cancel")
_RESULTS: Final = ("status", "feedback", "result")
_ROS2_ONLY: Final = (
    *("parameter_events", "describe_parameters", "get_parameter_types", "get_parameters"),
    *("list_parameters", "set_parameters", "set_parameters_atomically", "get_type_description"),
)


def import_sros2(xml: str) -> tuple[str, list[str]]:
    """A policy text, and what is not as in the XML, one line each: it allows less."""
    root = _parse(xml)
    found = _Found()
    if root.get("version") != VERSION:
        version = root.get("version", "(none)")[:20]
        found.notes.append(f"{_READ}the policy is of version {version!a}, as {VERSION}")
    rules: list[NewRule] = []
    taken: set[str] = set()
    repeated: Counter[str] = Counter()
    _check_structure(root, xml, found)
    for profile in root.iter("profile"):
        for rule in _profile(profile, found):
            repeated[rule.id] += 1
            number = repeated[rule.id]
            name = free_id(taken, f"{rule.id}-{number}" if number > 1 else rule.id)
            taken.add(name)
            rules.append(replace(rule, id=name))
    if found.lost:
        raise PolicyRefused(
            f"{len(found.lost)} parts of this policy cannot be kept as they are: {found.lost[0]}",
            "it would allow what the original denies: write these parts by hand, and remove them",
            (*found.lost, *map(described, found.notes)),
        )
    if not rules:
        raise PolicyRefused("no profile in this policy has rules", "is it an SROS2 policy?")
    return add_rules(empty("imported"), rules), found.notes


@dataclass
class _Found:
    """What is not as in the XML: `notes` allow less, for `lost` the policy is refused."""

    notes: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)


def _check_structure(root: Any, xml: str, found: _Found) -> None:
    # Note every element and attribute that is not read: it may deny something.
    for item in root.iter():
        tag = str(item.tag)
        if tag.endswith("}include"):
            href = str(item.get("href", ""))
            line = xml[: max(0, xml.find(href))].count("\n") + 1
            found.lost.append(f"line {line}: the include of {href[:200]!a} is not followed")
            continue
        known = _ATTRIBUTES.get(tag)
        if known is None:
            found.lost.append(f"<{tag[:60]}> is not an element of an SROS2 policy")
            continue
        strange = [name for name in item.attrib if name not in known]
        found.lost += [f"<{tag}> has an attribute {name[:60]!a}" for name in strange]
        for child in item:
            if isinstance(child.tag, str) and child.tag in _ATTRIBUTES and child.tag not in _BELOW[tag]:
                found.lost.append(f"<{child.tag}> is not expected in <{tag}>")


def described(line: str) -> str:
    """A note for people."""
    return line if line.startswith(_READ) else f"left out: {line}"


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
    # The root; the cost of a tree is in its elements and attributes, so they are counted first. A DTD is
    # refused before anything in it is read: entities that expand each other are a few bytes and fill the
    # memory.
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


def _profile(profile: Any, found: _Found) -> Iterator[NewRule]:
    namespace = "/" + profile.get("ns", "/").strip("/")
    node = f"{namespace.rstrip('/')}/{profile.get('node', '').strip('/')}"
    if profile.get("node") == _DEFAULT:
        found.lost.append(f"profile {node}: {_DEFAULT!r} is every node of its enclave")
        return
    if not _is_pattern(node):
        denies = any("DENY" in group.attrib.values() for group in profile)
        where = found.lost if denies else found.notes
        where.append(f"profile {node}: not a node name or pattern")
        return
    rights: dict[str, dict[str, dict[str, None]]] = {"allow": {}, "deny": {}}
    for tag, (child, labels) in _KINDS.items():
        for group in profile.findall(tag):
            for attribute, names in labels.items():
                if attribute in group.attrib:
                    read = _Group(node, namespace, child, attribute, names)
                    _read_group(group, read, rights, found)
    for effect, given in rights.items():
        if given:
            name = f"{'sros2' if effect == 'allow' else 'sros2-deny'}{node.replace('/', '-')}"
            clean = name.replace("*", "any")[:70]
            who = _deep(node) if effect == "deny" else node
            yield NewRule(clean, "imported from SROS2; review me", who, effect, given)


class _Group(NamedTuple):
    node: str
    namespace: str
    child: str
    attribute: str
    labels: tuple[str, ...]


def _read_group(
    group: Any, read: _Group, rights: dict[str, dict[str, dict[str, None]]], found: _Found
) -> None:
    where = f"{read.node}: {read.attribute}"
    effect = {"ALLOW": "allow", "DENY": "deny"}.get(group.get(read.attribute))
    if effect is None:
        found.lost.append(f"{where} is {group.get(read.attribute)[:40]!a}, not ALLOW or DENY")
        return
    items = group.findall(read.child)
    if not items:
        found.notes.append(f"{_READ}{where} {effect.upper()} as nothing, its list is empty")
    for item in items:
        asked = _resolve((item.text or "").strip(), read.namespace)
        pattern = _deep(asked)
        if effect == "allow" and pattern.rsplit("/", 1)[-1] in _ROS2_ONLY:
            found.notes.append(f"{read.node}: {pattern} exists in ROS 2 only")
        elif not _is_pattern(pattern) or (effect == "deny" and any(mark in asked for mark in "?[]")):
            lost = found.lost if effect == "deny" else found.notes
            lost.append(f"{where} {asked} is not a pattern of whole segments")
        else:
            if pattern != asked:
                found.notes.append(f"{_READ}{where} {asked} as {pattern}, its * crosses / in SROS2")
            for label, name in _rights(read.attribute, read.labels, pattern):
                rights[effect].setdefault(label, {})[name] = None


def _deep(pattern: str) -> str:
    # SROS2 matches with fnmatch, whose `*` stands for any characters, `/` too.
    return "/".join("**" if part == "*" else part for part in pattern.split("/"))


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
