"""One rule of a policy: for whom, which rights on which names, and how restricted.

The restriction of a rule is worked out for every topic of the rule by itself, against the type of
that topic: a filter that fits one of two topics is a mistake, not half a filter.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from grants.filters.layout import Layout
from grants.filters.presets import PRESETS, preset
from grants.model import ALL_RIGHTS, MESSAGE_RIGHTS, FilterRule, Restriction, Right
from grants.policy import readers
from grants.policy.fields import (
    FieldRule,
    When,
    check_fields,
    check_preset,
    check_when,
    read_fields,
    read_when,
)
from grants.policy.mistakes import Mistakes, SourcePosition, suggest
from grants.policy.model import (
    EVERYONE,
    Clause,
    Defaults,
    Effect,
    PolicyRule,
    SubjectPattern,
    type_of,
)
from grants.policy.source import Part, YamlMapping

_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}", re.ASCII)
_EFFECTS: Final = tuple(effect.value for effect in Effect)
_RESTRICTING: Final = ("when", "filter", "limit", "on_stale", "lifetime", "renew_until")
_ON_STALE: Final = ("cut", "keep")
_KEYS: Final = ("id", "why", "who", "except", *_EFFECTS, *_RESTRICTING)
RIGHTS: Final = {right.label: right for right in ALL_RIGHTS}

_Fields = tuple[FieldRule, ...]


@dataclass(frozen=True)
class _Chosen:
    """What filters one topic: fields, or a preset by name."""

    place: SourcePosition
    fields: _Fields = ()
    preset: str | None = None


class RuleReader:
    """Reads rules in the light of the rest of the policy."""

    def __init__(
        self,
        mistakes: Mistakes,
        defaults: Defaults,
        identities: Mapping[str, SubjectPattern],
        types: Mapping[str, str],
        layouts: Mapping[str, Layout],
        filters: Mapping[str, _Fields],
    ) -> None:
        self._mistakes = mistakes
        self._defaults = defaults
        self._identities = identities
        self._types = types
        self._layouts = layouts
        self._filters = filters

    def read(self, part: Part) -> PolicyRule | None:
        """One rule, or None if not even its outline is right."""
        table = readers.table(part, "a rule", self._mistakes)
        if table is None:
            return None
        name = readers.text(table.get("id"), "id", self._mistakes) or "?"
        if name != "?" and _ID.fullmatch(name) is None:
            self._mistakes.add(table, f"not an id: {name[:60]!r}", "letters, digits and dashes")
        readers.closed(table, f"rule {name}", _KEYS, ("id", "who"), self._mistakes)
        effect, rights = self._effect(table, name)
        if effect is None or rights is None:
            return None
        lifetime = readers.duration(table.get("lifetime"), "lifetime", self._mistakes)
        renew = readers.duration(
            table.get("renew_until"), "renew_until", self._mistakes, never=True
        )
        stale = readers.choice(table.get("on_stale"), "on_stale", _ON_STALE, self._mistakes)
        return PolicyRule(
            id=name,
            effect=effect,
            who=self._people(table.get("who")),
            exceptions=self._people(table.get("except")),
            why=readers.text(table.get("why"), "why", self._mistakes) or "",
            clauses=self._clauses(table, rights, name),
            lifetime=self._defaults.lifetime if lifetime is None else lifetime,
            renew_until=self._defaults.renew_until if renew is None else renew,
            own_lifetime=lifetime is not None,
            keep_when_stale=stale == "keep",
            line=table.line,
        )

    def _effect(self, table: YamlMapping, name: str) -> tuple[Effect | None, YamlMapping | None]:
        said = [effect for effect in Effect if effect.value in table.entries]
        if len(said) != 1:
            hint = "write it as two rules" if said else "for example allow: {subscribe: [/topic]}"
            self._mistakes.add(table, f"rule {name} needs one of allow, deny and prompt", hint)
            return None, None
        [effect] = said
        for word in _RESTRICTING if effect is Effect.DENY else ():
            if word in table.entries:
                place = table.entries[word][0]
                message = f"rule {name}: a denial has no {word!r}, it always holds"
                self._mistakes.add(place, message, "take it out, or write an allow rule")
        rights = table.get(effect.value)
        return effect, readers.table(rights, f"{effect.value} of rule {name}", self._mistakes)

    def _people(self, part: Part | None) -> tuple[SubjectPattern, ...]:
        people = (self._person(item) for item in readers.words(part))
        return tuple(who for who in people if who is not None)

    def _person(self, part: Part) -> SubjectPattern | None:
        label = readers.text(part, "who", self._mistakes)
        if label is None:
            return None
        if label == EVERYONE:
            return SubjectPattern(label, "/**")
        if label.startswith("/"):
            node = readers.pattern(part, "who", self._mistakes)
            return SubjectPattern(label, node) if node is not None else None
        if label not in self._identities:
            message = f"unknown identity {label[:60]!r}"
            self._mistakes.add(part, message, suggest(label, self._identities))
            return None
        return self._identities[label]

    def _clauses(self, table: YamlMapping, rights: YamlMapping, name: str) -> tuple[Clause, ...]:
        named = self._named(rights, name)
        whens = [read_when(item, self._mistakes) for item in readers.words(table.get("when"))]
        conditions = [when for when in whens if when is not None]
        topics = [pattern for right, pattern, _ in named if right is Right.SUBSCRIBE]
        filters = self._filters_of(table.get("filter"), topics, name)
        rate = self._rate(table.get("limit"), topics, name)
        clauses: list[Clause] = []
        for right, pattern, place in named:
            clauses += self._clause(right, pattern, place, conditions, filters, rate)
        restricting = conditions or filters or rate or table.get("on_stale") is not None
        if restricting and any(right & ~MESSAGE_RIGHTS for right, _, _ in named):
            self._mistakes.add(
                rights,
                f"rule {name}: parameters, graph and admin cannot be restricted by messages",
                "put these rights into a rule of their own",
            )
        return tuple(clauses)

    def _named(self, rights: YamlMapping, name: str) -> list[tuple[Right, str, SourcePosition]]:
        """Every right and pattern the rule names."""
        if not rights.entries:
            self._mistakes.add(rights, f"rule {name} names no right", suggest("", RIGHTS))
        found: list[tuple[Right, str, SourcePosition]] = []
        for label, (key, value) in rights.entries.items():
            if label not in RIGHTS:
                message = f"unknown right {label[:60]!r} in rule {name}"
                self._mistakes.add(key, message, suggest(label, RIGHTS))
                continue
            items = readers.words(value)
            if not items:
                self._mistakes.add(value, f"rule {name}: {label} of nothing", "add a name")
            for item in items:
                pattern = readers.pattern(item, label, self._mistakes)
                if pattern is not None:
                    found.append((RIGHTS[label], pattern, item))
        return found

    def _clause(
        self,
        right: Right,
        pattern: str,
        place: SourcePosition,
        conditions: list[When],
        filters: Mapping[str, _Chosen],
        rate: float | None,
    ) -> list[Clause]:
        seen = right is Right.SUBSCRIBE
        chosen = filters.get(pattern, _Chosen(place)) if seen else _Chosen(place)
        kind = type_of(self._types, pattern)
        looks = chosen.fields or chosen.preset or any(when.message for when in conditions)
        if looks and not self._fits(right, pattern, place, kind, conditions, chosen):
            return []
        rules, limit = self._treatment(chosen, kind, rate if seen else None)
        if not conditions and not rules:
            return [Clause(right, pattern, None, limit, kind)]
        texts = tuple(dict.fromkeys(when.text for when in conditions))
        restriction = Restriction(kind if looks else None, texts, rules)
        return [Clause(right, pattern, restriction, limit, kind)]

    def _treatment(
        self, chosen: _Chosen, kind: str | None, rate: float | None
    ) -> tuple[tuple[FilterRule, ...], float | None]:
        """The rules and the rate; a preset brings its own, and the lower rate holds."""
        if chosen.preset is None or kind is None:
            return tuple(sorted(item.rule for item in chosen.fields)), rate
        made = preset(chosen.preset).restriction(self._layouts[kind])
        rates = [one for one in (made.rate, rate) if one is not None]
        return made.filters, min(rates, default=None)

    def _fits(
        self, right: Right, pattern: str, place: SourcePosition, kind: str | None,
        conditions: list[When], chosen: _Chosen,
    ) -> bool:  # fmt: skip
        """Whether what looks into the messages of `pattern` fits their type."""
        if not right & (Right.SUBSCRIBE | Right.PUBLISH):
            message = f"{right.label} {pattern}: conditions on messages are for topics"
            self._mistakes.add(place, message, "put this right into a rule of its own")
            return False
        if kind is None:
            message = f"the message type of {pattern} is not known here"
            hint = f"add it to types: {{{pattern}: package/Type}}"
            self._mistakes.add(place, message, hint)
            return False
        if kind not in self._layouts:
            return False  # the type itself is the mistake, and noted
        layout = self._layouts[kind]
        checked = [check_when(layout, when, self._mistakes) for when in conditions]
        if chosen.preset is not None:
            checked.append(check_preset(layout, chosen.preset, chosen.place, self._mistakes))
        if chosen.fields:
            checked.append(check_fields(layout, chosen.fields, chosen.place, self._mistakes))
        return all(checked)

    def _filters_of(self, part: Part | None, topics: list[str], name: str) -> dict[str, _Chosen]:
        """The filter of every topic: `{use: NAME}`, fields, or either of them by topic."""
        table = readers.table(part, f"filter of rule {name}", self._mistakes)
        if table is None:
            return {}
        if not topics or not table.entries:
            hint = "add a subscribe right, or take the filter out"
            self._mistakes.add(table, f"rule {name}: nothing to filter", hint)
            return {}
        if not any(key.startswith("/") for key in table.entries):
            return dict.fromkeys(topics, self._choice(table, table))
        found: dict[str, _Chosen] = {}
        for topic, (key, value) in table.entries.items():
            if topic not in topics:
                message = f"rule {name} does not let subscribe {topic[:80]!r}"
                self._mistakes.add(key, message, suggest(topic, topics))
                continue
            inner = readers.table(value, f"filter of {topic}", self._mistakes)
            if inner is not None:
                found[topic] = self._choice(key, inner)
        return found

    def _choice(self, place: SourcePosition, table: YamlMapping) -> _Chosen:
        """Fields, or `{use: NAME}` of a filter of this policy or else of a preset."""
        if "use" not in table.entries:
            return _Chosen(place, read_fields(table, self._mistakes))
        readers.closed(table, "a filter with use", ("use",), (), self._mistakes)
        known = {**PRESETS, **self._filters}
        name = readers.choice(table.get("use"), "filter", known, self._mistakes)
        if name is None or name in self._filters:
            return _Chosen(place, self._filters.get(name or "", ()))
        return _Chosen(place, preset=name)

    def _rate(self, part: Part | None, topics: list[str], name: str) -> float | None:
        table = readers.table(part, f"limit of rule {name}", self._mistakes)
        if table is None:
            return None
        readers.closed(table, f"limit of rule {name}", ("rate",), ("rate",), self._mistakes)
        if not topics:
            self._mistakes.add(table, f"rule {name}: nothing to limit", "add a subscribe right")
        return readers.number(table.get("rate"), "rate", self._mistakes)
