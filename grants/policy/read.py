"""The closed schema of a policy: from the tree of the file to a `Policy`, or to its mistakes.

Any other key is a mistake. Conditions and filters are compiled against the message type of every
topic they are for, so a rule that cannot be applied is never accepted.
"""

from collections.abc import Callable, Collection
from typing import Final

from ca.errors import HintedError
from ca.suggestions import closest
from grants.filters.layout import Layout, parse
from grants.policy import readers
from grants.policy.assertions import read_tests
from grants.policy.basics import ID as BASICS_ID
from grants.policy.basics import basics_rule, read_basics
from grants.policy.fields import FieldRule, read_fields
from grants.policy.mistakes import Mistake, Mistakes
from grants.policy.model import (
    EVERYONE,
    LIFETIME,
    PROMPT_TIMEOUT,
    Defaults,
    Effect,
    Policy,
    PolicyRule,
    SubjectPattern,
)
from grants.policy.own_names import NODE
from grants.policy.rules import RuleReader
from grants.policy.source import Part, YamlMapping, YamlScalar, read_source
from grants.policy.subjects import Subjects
from grants.policy.titles import read_titles
from grants.policy.vocabulary import Vocabulary, read_vocabulary

VERSION: Final = 1
_TOP: Final = (
    "rossec", "robot", "basics", "defaults", "identities", "groups", "types", "vocabulary",
    "rooms", "filters", "rules", "tests", "title",
)  # fmt: skip
_REQUIRED: Final = {
    "rossec": "rossec: 1",
    "robot": "robot: NAME, what the policy is for: a robot, a home; reports are headed with it",
    "rules": "rules: []",
}
_DEFAULTS: Final = ("decision", "lifetime", "renew_until", "prompt_timeout")

Definition = Callable[[str], str]


def load(
    text: str,
    definition: Definition,
    *,
    file: str = "policy.yaml",
    known_types: Collection[str] = (),
) -> Policy:
    """Read a policy.

    Args:
        text: of the file.
        definition: the definition text of a message type by name; raises a `HintedError` if it
            is unknown.
        file: its name, for mistakes.
        known_types: names to suggest for a misspelt type.

    Raises:
        PolicyRefused: with every mistake of the file.
    """
    mistakes = Mistakes(file)
    source = read_source(text, mistakes)
    policy = _PolicyReader(mistakes, definition, known_types).read(source)
    mistakes.raise_if_any()
    return policy


def mistakes_in(error: Exception) -> tuple[Mistake, ...]:
    """The mistakes a `PolicyRefused` carries."""
    found = getattr(error, "mistakes", ())
    return tuple(item for item in found if isinstance(item, Mistake))


class _PolicyReader:
    def __init__(
        self, mistakes: Mistakes, definition: Definition, known_types: Collection[str]
    ) -> None:
        self._mistakes = mistakes
        self._definition = definition
        self._known_types = known_types

    def read(self, source: Part | None) -> Policy:
        if not isinstance(source, YamlMapping):
            position = source or YamlScalar("", 1, 1)
            self._mistakes.add(position, "a policy is a mapping", "begin with: rossec: 1")
            source = YamlMapping({}, 1, 1)
        readers.check_keys(source, "the policy", _TOP, _REQUIRED, self._mistakes)
        self._version(source.get("rossec"))
        defaults = self._defaults(source.get("defaults"))
        identities = self._identities(source.get("identities"))
        layouts, types = self._types(source.get("types"))
        vocabulary = self._vocabulary(source, types, layouts)
        filters = self._filters(source.get("filters"))
        subjects = Subjects(self._mistakes, identities, source.get("groups"))
        reader = RuleReader(self._mistakes, defaults, subjects, types, layouts, filters, vocabulary)
        rules = self._rules(source.get("rules"), reader)
        rules += self._basics(source.get("basics"), defaults, rules)
        robot = readers.text(source.get("robot"), "robot", self._mistakes)
        filter_rules = {name: tuple(item.rule for item in rules) for name, rules in filters.items()}
        tests = read_tests(source.get("tests"), identities, subjects.groups, self._mistakes)
        return Policy(
            robot or "", defaults, identities, types, rules, self._mistakes.file, filter_rules,
            subjects.groups, subjects.unused, vocabulary, tests,
            read_titles(source.get("title"), subjects.groups, self._mistakes),
        )  # fmt: skip

    def _basics(
        self, part: Part | None, defaults: Defaults, rules: tuple[PolicyRule, ...]
    ) -> tuple[PolicyRule, ...]:
        extras = read_basics(part, self._mistakes)
        if part is None or extras is None:
            return ()
        for rule in rules:
            if rule.id == BASICS_ID:
                at = YamlScalar("", rule.line, 1)
                self._mistakes.add(at, f"the rule of basics is called {rule.id!r}", "rename it")
        return (basics_rule(extras, part.line, defaults, rules),)

    def _version(self, part: Part | None) -> None:
        if part is not None and not (isinstance(part, YamlScalar) and part.value is not True
                                     and part.value == VERSION):  # fmt: skip
            hint = f"this rossec reads version {VERSION}"
            self._mistakes.add(part, "a policy of an unknown version", hint)

    def _defaults(self, part: Part | None) -> Defaults:
        mapping = readers.mapping(part, "defaults", self._mistakes)
        if mapping is None:
            return Defaults()
        readers.check_keys(mapping, "defaults", _DEFAULTS, (), self._mistakes)
        decision = readers.choice(
            mapping.get("decision"), "default decision", ("deny", "prompt"), self._mistakes
        )
        lifetime = readers.duration(mapping.get("lifetime"), "lifetime", self._mistakes)
        renew = readers.duration(
            mapping.get("renew_until"), "renew_until", self._mistakes, never=True
        )
        timeout = readers.duration(mapping.get("prompt_timeout"), "prompt_timeout", self._mistakes)
        return Defaults(
            Effect(decision) if decision is not None else Effect.DENY,
            LIFETIME if lifetime is None else lifetime,
            renew or 0,
            PROMPT_TIMEOUT if timeout is None else timeout,
            has_lifetime=lifetime is not None,
        )

    def _identities(self, part: Part | None) -> dict[str, SubjectPattern]:
        mapping = readers.mapping(part, "identities", self._mistakes)
        found: dict[str, SubjectPattern] = {}
        for name, (key, value) in mapping.entries.items() if mapping is not None else ():
            who = self._identity(name, key, value)
            # Kept even if invalid, so that rules with it are not reported as well.
            found[name] = who or SubjectPattern(name)
        return found

    def _identity(self, name: str, key: YamlScalar, part: Part) -> SubjectPattern | None:
        if name == EVERYONE or name.startswith("/") or ":" in name:
            self._mistakes.add(key, f"{name[:60]!r} cannot be the name of an identity")
        mapping = readers.mapping(part, f"identity {name}", self._mistakes)
        if mapping is None:
            return None
        readers.check_keys(mapping, f"identity {name}", ("node", "key"), (), self._mistakes)
        node = readers.subject(mapping.get("node"), f"node of {name}", self._mistakes)
        pinned = readers.key(mapping.get("key"), self._mistakes)
        if mapping.get("node") is None and mapping.get("key") is None:
            self._mistakes.add(
                mapping, f"identity {name} has neither node nor key", "add node: /name, or key: ..."
            )
        return SubjectPattern(name, node, pinned)

    def _types(self, part: Part | None) -> tuple[dict[str, Layout], dict[str, str]]:
        """Layouts by type name, and type names by topic pattern."""
        layouts: dict[str, Layout] = {}
        types: dict[str, str] = {}
        mapping = readers.mapping(part, "types", self._mistakes)
        kinds: dict[YamlScalar, str] = {}
        for key, value in mapping.entries.values() if mapping is not None else ():
            name = readers.text(value, f"the type of {key.value}", self._mistakes)
            if name is not None and name not in layouts:
                self._layout(name, value, layouts)
            if name is not None:
                kinds[key] = name
        for topic, key, _ in readers.by_name(
            mapping, "types", lambda key: readers.pattern(key, "topic", self._mistakes),
            self._mistakes,
        ):  # fmt: skip
            if topic == NODE:
                self._mistakes.add(key, f"{NODE} is no topic", "name one of its topics: ~/pose")
            if key in kinds:
                types[topic] = kinds[key]
        return layouts, types

    def _layout(self, name: str, position: Part, layouts: dict[str, Layout]) -> None:
        try:
            layouts[name] = parse(name, self._definition(name))
        except HintedError as error:
            near = closest(name, self._known_types)
            hint = error.hint if near is None else f"did you mean {near!r}?"
            self._mistakes.add(position, str(error), hint)

    def _vocabulary(
        self, source: YamlMapping, types: dict[str, str], layouts: dict[str, Layout]
    ) -> Vocabulary:
        known = dict(layouts)

        def layout_of(name: str, position: YamlScalar) -> Layout | None:
            if name not in known:
                self._layout(name, position, known)
            return known.get(name)

        said, rooms = source.get("vocabulary"), source.get("rooms")
        return read_vocabulary(said, rooms, types, layout_of, self._mistakes)

    def _filters(self, part: Part | None) -> dict[str, tuple[FieldRule, ...]]:
        found: dict[str, tuple[FieldRule, ...]] = {}
        mapping = readers.mapping(part, "filters", self._mistakes)
        for name, (_, value) in mapping.entries.items() if mapping is not None else ():
            fields = readers.mapping(value, f"filter {name}", self._mistakes)
            found[name] = read_fields(fields, self._mistakes) if fields is not None else ()
        return found

    def _rules(self, part: Part | None, reader: RuleReader) -> tuple[PolicyRule, ...]:
        first: dict[str, Part] = {}
        rules: list[PolicyRule] = []
        for item in readers.items(part):
            rule = reader.read(item)
            if rule is None:
                continue
            if rule.id in first:
                at = f"{first[rule.id].line}:{first[rule.id].column}"
                message = f"duplicate rule {rule.id!r}; the first is in {at}"
                self._mistakes.add(item, message, "use a unique id")
            first.setdefault(rule.id, item)
            rules.append(rule)
        return tuple(rules)
