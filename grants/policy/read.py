"""The closed schema of a policy: from the tree of the file to a `Policy`, or to its mistakes. Pure.

Any other key is a mistake. Conditions and filters are compiled against the message type of every topic they
are for, so a rule that cannot be applied is never accepted.
`policy.schema.json` beside this module tells editors structure and keys; `tools/schema.py` writes it.
"""

import unicodedata
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final

from ca.errors import HintedError
from ca.names import closest
from grants.filters.layout import Layout, parse
from grants.policy import source
from grants.policy.assertions import read_tests
from grants.policy.model import (
    EVERYONE,
    LIFETIME,
    PROMPT_TIMEOUT,
    Defaults,
    Effect,
    Policy,
    PolicyRule,
    SubjectPattern,
    Vocabulary,
    read_vocabulary,
)
from grants.policy.names import NODE
from grants.policy.restrictions import FieldRule, read_fields
from grants.policy.rules import ID as BASICS_ID
from grants.policy.rules import RuleReader, Subjects, basics_rule, read_basics
from grants.policy.source import Mistake, Mistakes, Part, YamlMapping, YamlScalar, read_source, suggest

VERSION: Final = 1
_TOP: Final = (
    *("rossec", "robot", "basics", "defaults", "identities", "groups", "types", "vocabulary", "rooms"),
    *("filters", "rules", "tests", "title"),
)
_REQUIRED: Final = {
    "rossec": "rossec: 1",
    "robot": "robot: NAME, what the policy is for: a robot, a home; reports are headed with it",
    "rules": "rules: []",
}
_DEFAULTS: Final = ("decision", "lifetime", "renew_until", "prompt_timeout")

MAX_TITLE: Final = 60  # characters
_MAX_MARKS: Final = 2  # combining ones in a row: more of them cover the lines above and below
_MARKS: Final = (["Mn"], ["Me"], ["Mc"])
_HARMFUL: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})

Definition = Callable[[str], str]  # from the name of a message type to its text


def load(
    text: str, definition: Definition, *, file: str = "policy.yaml", known_types: Collection[str] = ()
) -> Policy:
    """Read a policy from the text of its `file`; `definition` raises a `HintedError` for an unknown type."""
    mistakes = Mistakes(file)
    top = read_source(text, mistakes)
    policy = _PolicyReader(mistakes, definition, known_types).read(top)
    mistakes.raise_if_any()
    return policy


def mistakes_in(error: Exception) -> tuple[Mistake, ...]:
    """The mistakes a `PolicyRefused` carries."""
    return tuple(item for item in getattr(error, "mistakes", ()) if isinstance(item, Mistake))


@dataclass
class _PolicyReader:
    _mistakes: Mistakes
    _definition: Definition
    _known_types: Collection[str]

    def read(self, top: Part | None) -> Policy:
        if not isinstance(top, YamlMapping):
            position = top or YamlScalar(1, 1, self._mistakes, "")
            position.mistake("a policy is a mapping", "begin with: rossec: 1")
            top = YamlMapping(1, 1, self._mistakes, {})
        source.check_keys(top, "the policy", _TOP, _REQUIRED)
        version = top.get("rossec")
        if version is not None and (
            not isinstance(version, YamlScalar) or version.value is True or version.value != VERSION
        ):
            version.mistake("a policy of an unknown version", f"this rossec reads version {VERSION}")
        defaults = self._defaults(top.get("defaults"))
        identities = self._identities(top.get("identities"))
        layouts, types = self._types(top.get("types"))
        vocabulary = self._vocabulary(top, types, layouts)
        filters = self._filters(top.get("filters"))
        subjects = Subjects(identities, top.get("groups"))
        reader = RuleReader(defaults, subjects, types, layouts, filters, vocabulary)
        rules = self._rules(top.get("rules"), reader)
        basics = top.get("basics")
        if basics is not None and (extras := read_basics(basics)) is not None:
            for rule in rules:
                if rule.id == BASICS_ID:
                    self._mistakes.add(rule.line, 1, f"the rule of basics is called {rule.id!r}", "rename it")
            rules = (*rules, basics_rule(extras, basics.line, defaults, rules))
        robot = source.text(top.get("robot"), "robot")
        filter_rules = {name: tuple(item.rule for item in rules) for name, rules in filters.items()}
        tests = read_tests(top.get("tests"), identities, subjects.groups)
        return Policy(
            robot or "",
            defaults,
            identities,
            types,
            rules,
            self._mistakes.file,
            filter_rules,
            subjects.groups,
            subjects.unused,
            vocabulary,
            tests,
            read_titles(top.get("title"), subjects.groups),
        )

    def _defaults(self, part: Part | None) -> Defaults:
        mapping = source.mapping(part, "defaults")
        if mapping is None:
            return Defaults()
        source.check_keys(mapping, "defaults", _DEFAULTS, ())
        choices = ("deny", "prompt")
        decision = source.choice(mapping.get("decision"), "default decision", choices)
        lifetime = source.duration(mapping.get("lifetime"), "lifetime")
        renew = source.duration(mapping.get("renew_until"), "renew_until", never=True)
        timeout = source.duration(mapping.get("prompt_timeout"), "prompt_timeout")
        return Defaults(
            Effect(decision) if decision is not None else Effect.DENY,
            LIFETIME if lifetime is None else lifetime,
            renew or 0,
            PROMPT_TIMEOUT if timeout is None else timeout,
            has_lifetime=lifetime is not None,
        )

    def _identities(self, part: Part | None) -> dict[str, SubjectPattern]:
        found: dict[str, SubjectPattern] = {}
        for name, key, value in source.entries(part, "identities"):
            if name == EVERYONE or name.startswith("/") or ":" in name:
                key.mistake(f"{name[:60]!r} cannot be the name of an identity")
            # Kept even if invalid, so that rules with it are not reported as well.
            found[name] = SubjectPattern(name)
            who = source.mapping(value, f"identity {name}")
            if who is None:
                continue
            source.check_keys(who, f"identity {name}", ("node", "key"), ())
            node = source.subject(who.get("node"), f"node of {name}")
            found[name] = SubjectPattern(name, node, source.key(who.get("key")))
            if who.get("node") is None and who.get("key") is None:
                who.mistake(f"identity {name} has neither node nor key", "add node: /name, or key: ...")
        return found

    def _types(self, part: Part | None) -> tuple[dict[str, Layout], dict[str, str]]:
        layouts: dict[str, Layout] = {}
        types: dict[str, str] = {}
        kinds: dict[YamlScalar, str] = {}
        for _, key, value in source.entries(part, "types"):
            name = source.text(value, f"the type of {key.value}")
            if name is not None and name not in layouts:
                self._layout(name, value, layouts)
            if name is not None:
                kinds[key] = name
        for topic, key, _ in source.by_name(part, "types", lambda key: source.pattern(key, "topic")):
            if topic == NODE:
                key.mistake(f"{NODE} is no topic", "name one of its topics: ~/pose")
            if key in kinds:
                types[topic] = kinds[key]
        return layouts, types

    def _layout(self, name: str, position: Part, layouts: dict[str, Layout]) -> None:
        try:
            layouts[name] = parse(name, self._definition(name))
        except HintedError as error:
            near = closest(name, self._known_types)
            position.mistake(str(error), error.hint if near is None else f"did you mean {near!r}?")

    def _vocabulary(
        self, source: YamlMapping, types: dict[str, str], layouts: dict[str, Layout]
    ) -> Vocabulary:
        known = dict(layouts)

        def layout_of(name: str, position: YamlScalar) -> Layout | None:
            if name not in known:
                self._layout(name, position, known)
            return known.get(name)

        return read_vocabulary(source.get("vocabulary"), source.get("rooms"), types, layout_of)

    def _filters(self, part: Part | None) -> dict[str, tuple[FieldRule, ...]]:
        found: dict[str, tuple[FieldRule, ...]] = {}
        for name, _, value in source.entries(part, "filters"):
            fields = source.mapping(value, f"filter {name}")
            found[name] = read_fields(fields) if fields is not None else ()
        return found

    def _rules(self, part: Part | None, reader: RuleReader) -> tuple[PolicyRule, ...]:
        first: dict[str, Part] = {}
        rules: list[PolicyRule] = []
        for item in source.items(part):
            rule = reader.read(item)
            if rule is not None and rule.id in first:
                at = f"{first[rule.id].line}:{first[rule.id].column}"
                item.mistake(f"duplicate rule {rule.id!r}; the first is in {at}", "use a unique id")
            if rule is not None:
                first.setdefault(rule.id, item)
                rules.append(rule)
        return tuple(rules)


# Titles: `title: {/doctor: Dr. Meier, /robot/pose: where the robot is, lamps: a lamp of the house}`, that
# of a group for its members. A title decides nothing, and is shown beside the name of ROS, never instead of
# it. So that it can imitate neither a name nor another title, no two names have the same, and `flaw_of`
# bounds it.


def flaw_of(title: str) -> str:
    kinds = [unicodedata.category(char) for char in title]
    spaces = {char for kind, char in zip(kinds, title, strict=True) if kind == "Zs"}
    runs = "".join("M" if kind in ("Mn", "Me") else " " for kind in kinds).split()
    flaws = (
        (not 1 <= len(title) <= MAX_TITLE, f"1 to {MAX_TITLE} characters"),
        (not _HARMFUL.isdisjoint(kinds), "no control, format or direction characters"),
        (not spaces <= {" "}, "no other spaces than the usual one"),
        (" ".join(title.split()) != title, "single spaces, and none at its ends"),
        (unicodedata.normalize("NFC", title) != title, "the composed form of Unicode (NFC)"),
        (kinds[:1] in _MARKS or max(map(len, runs), default=0) > _MAX_MARKS, "few combining marks"),
        ("/" in title, "no slash: it would look like a name"),
    )
    return next((f"a title has {said}" for is_flawed, said in flaws if is_flawed), "")


def read_titles(part: Part | None, groups: Mapping[str, tuple[SubjectPattern, ...]]) -> dict[str, str]:
    found: dict[str, str] = {}
    of_groups: dict[str, str] = {}
    first: dict[str, YamlScalar] = {}
    for text, key, value in source.entries(part, "title"):
        title = source.text(value, f"the title of {text[:60]}")
        names = _names(text, key, groups)
        if title is not None and (flaw := flaw_of(title)):
            value.mistake(f"the title of {text[:60]}: {flaw}", "for example: Dr. Meier")
            continue
        if title is None or not names:
            continue
        same = title.casefold()
        if same in first:
            source.again(value, f"title: {title!r}", first[same])
        first.setdefault(same, key)
        (of_groups if text in groups else found).update(dict.fromkeys(names, title))
    return {**of_groups, **found}


def _names(text: str, key: YamlScalar, groups: Mapping[str, tuple[SubjectPattern, ...]]) -> tuple[str, ...]:
    if text.startswith("/") or ":" in text:
        name = source.subject(key, "title")
        return () if name is None else (name,)
    if text in groups:
        return tuple(each.node for each in groups[text] if each.node is not None)
    hint = suggest(text, groups) if groups else "a name begins with /: /doctor, /robot/pose"
    key.mistake(f"title: {text[:60]!r} is neither a name nor a group", hint)
    return ()
