"""The closed schema of a policy: from the tree of the file to a `Policy`, or to its mistakes.

Whatever is not named here is a mistake. Conditions and filters are compiled against the message
type of every topic they are for, so a rule that could not be applied is never accepted.
"""

from collections.abc import Callable, Collection
from typing import Final

from ca.errors import HintedError
from grants.filters.layout import Layout, parse
from grants.policy import readers
from grants.policy.fields import FieldRule, read_fields
from grants.policy.mistakes import Mistake, Mistakes, suggest
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
from grants.policy.rules import RuleReader
from grants.policy.source import Part, YamlMapping, YamlScalar, read_source

VERSION: Final = 1
_TOP: Final = ("rossec", "robot", "defaults", "identities", "types", "filters", "rules")
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
        definition: the definition text of a message type by name; raises a `HintedError` when
            there is none.
        file: its name, for mistakes.
        known_types: names to suggest for a misspelt type.

    Raises:
        PolicyRefused: with every mistake of the file.
    """
    mistakes = Mistakes(file)
    source = read_source(text, mistakes)
    policy = _Reader(mistakes, definition, known_types).read(source)
    mistakes.refuse_any()
    return policy


def mistakes_in(error: Exception) -> tuple[Mistake, ...]:
    """The mistakes a `PolicyRefused` carries."""
    found = getattr(error, "mistakes", ())
    return tuple(item for item in found if isinstance(item, Mistake))


class _Reader:
    def __init__(
        self, mistakes: Mistakes, definition: Definition, known_types: Collection[str]
    ) -> None:
        self._mistakes = mistakes
        self._definition = definition
        self._known_types = known_types

    def read(self, source: Part | None) -> Policy:
        if not isinstance(source, YamlMapping):
            place = source or YamlScalar("", 1, 1)
            self._mistakes.add(place, "a policy is a mapping", "begin with: rossec: 1")
            source = YamlMapping({}, 1, 1)
        readers.closed(source, "the policy", _TOP, ("rossec", "robot", "rules"), self._mistakes)
        self._version(source.get("rossec"))
        defaults = self._defaults(source.get("defaults"))
        identities = self._identities(source.get("identities"))
        layouts, types = self._types(source.get("types"))
        filters = self._filters(source.get("filters"))
        reader = RuleReader(self._mistakes, defaults, identities, types, layouts, filters)
        rules = self._rules(source.get("rules"), reader)
        robot = readers.text(source.get("robot"), "robot", self._mistakes)
        plain = {name: tuple(item.rule for item in rules) for name, rules in filters.items()}
        return Policy(robot or "", defaults, identities, types, rules, self._mistakes.file, plain)

    def _version(self, part: Part | None) -> None:
        if part is not None and not (isinstance(part, YamlScalar) and part.value is not True
                                     and part.value == VERSION):  # fmt: skip
            hint = f"this rossec reads version {VERSION}"
            self._mistakes.add(part, "a policy of an unknown version", hint)

    def _defaults(self, part: Part | None) -> Defaults:
        table = readers.table(part, "defaults", self._mistakes)
        if table is None:
            return Defaults()
        readers.closed(table, "defaults", _DEFAULTS, (), self._mistakes)
        said = readers.choice(
            table.get("decision"), "default decision", ("deny", "prompt"), self._mistakes
        )
        lifetime = readers.duration(table.get("lifetime"), "lifetime", self._mistakes)
        renew = readers.duration(
            table.get("renew_until"), "renew_until", self._mistakes, never=True
        )
        timeout = readers.duration(table.get("prompt_timeout"), "prompt_timeout", self._mistakes)
        return Defaults(
            Effect(said) if said is not None else Effect.DENY,
            LIFETIME if lifetime is None else lifetime,
            renew or 0,
            PROMPT_TIMEOUT if timeout is None else timeout,
            own_lifetime=lifetime is not None,
        )

    def _identities(self, part: Part | None) -> dict[str, SubjectPattern]:
        table = readers.table(part, "identities", self._mistakes)
        found: dict[str, SubjectPattern] = {}
        for name, (key, value) in table.entries.items() if table is not None else ():
            who = self._identity(name, key, value)
            # Kept even if faulty, so that its users are not reported as well.
            found[name] = who or SubjectPattern(name)
        return found

    def _identity(self, name: str, key: YamlScalar, part: Part) -> SubjectPattern | None:
        if name == EVERYONE or name.startswith("/"):
            self._mistakes.add(key, f"{name[:60]!r} cannot be the name of an identity")
        table = readers.table(part, f"identity {name}", self._mistakes)
        if table is None:
            return None
        readers.closed(table, f"identity {name}", ("node", "key"), (), self._mistakes)
        node = readers.pattern(table.get("node"), f"node of {name}", self._mistakes)
        pinned = readers.key(table.get("key"), self._mistakes)
        if table.get("node") is None and table.get("key") is None:
            self._mistakes.add(table, f"identity {name} is nobody", "add node: /name, or key: ...")
        return SubjectPattern(name, node, pinned)

    def _types(self, part: Part | None) -> tuple[dict[str, Layout], dict[str, str]]:
        """Layouts by type name, and type names by topic pattern."""
        layouts: dict[str, Layout] = {}
        types: dict[str, str] = {}
        table = readers.table(part, "types", self._mistakes)
        for key, value in table.entries.values() if table is not None else ():
            topic = readers.pattern(key, "topic", self._mistakes)
            name = readers.text(value, f"the type of {key.value}", self._mistakes)
            if name is not None and topic is not None:
                types[topic] = name
            if name is not None and name not in layouts:
                self._layout(name, value, layouts)
        return layouts, types

    def _layout(self, name: str, place: Part, layouts: dict[str, Layout]) -> None:
        try:
            layouts[name] = parse(name, self._definition(name))
        except HintedError as error:
            hint = suggest(name, self._known_types) if self._known_types else error.hint
            self._mistakes.add(place, str(error), hint)

    def _filters(self, part: Part | None) -> dict[str, tuple[FieldRule, ...]]:
        found: dict[str, tuple[FieldRule, ...]] = {}
        table = readers.table(part, "filters", self._mistakes)
        for name, (_, value) in table.entries.items() if table is not None else ():
            fields = readers.table(value, f"filter {name}", self._mistakes)
            found[name] = read_fields(fields, self._mistakes) if fields is not None else ()
        return found

    def _rules(self, part: Part | None, reader: RuleReader) -> tuple[PolicyRule, ...]:
        seen: dict[str, int] = {}
        rules: list[PolicyRule] = []
        for item in readers.words(part):
            rule = reader.read(item)
            if rule is None:
                continue
            if rule.id in seen:
                message = f"a second rule {rule.id!r}; the first stands in line {seen[rule.id]}"
                self._mistakes.add(item, message, "give it an id of its own")
            seen.setdefault(rule.id, rule.line)
            rules.append(rule)
        return tuple(rules)
