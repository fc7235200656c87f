"""One rule of a policy: its subjects, its rights on names, and their restrictions.

The restriction of a rule is determined for every topic of the rule separately, against the type of
that topic: a filter that fits one of two topics is a mistake, not half a filter.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from grants.errors import GrantError, GrantMalformed
from grants.filters.hashing import key_names
from grants.filters.layout import Layout
from grants.filters.presets import PRESETS, preset
from grants.model import ALL_RIGHTS, MESSAGE_RIGHTS, Permission, Restriction, Right
from grants.policy import readers
from grants.policy.fields import (
    ConditionRule,
    FieldRule,
    check_condition,
    check_fields,
    check_preset,
    read_condition,
    read_fields,
)
from grants.policy.limiting import Limit, read_limit
from grants.policy.mistakes import Mistakes, SourcePosition, suggest
from grants.policy.model import Clause, Defaults, Effect, PolicyRule, type_of
from grants.policy.own_names import BEGINS_TOPIC, NODE, any_node
from grants.policy.seeing import TopicLevels, read_see, resolve_levels
from grants.policy.signable import why_unsignable
from grants.policy.source import Part, YamlMapping
from grants.policy.subjects import Subjects
from grants.policy.vocabulary import Vocabulary
from grants.vocabulary.resolve import Resolved, together

_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}", re.ASCII)
_EFFECTS: Final = tuple(effect.value for effect in Effect)
_RESTRICTING: Final = ("when", "filter", "see", "limit", "on_stale", "lifetime", "renew_until")
_ON_STALE: Final = ("cut", "keep")
_KEYS: Final = ("id", "why", "who", "except", *_EFFECTS, *_RESTRICTING)
RIGHTS: Final = {right.label: right for right in ALL_RIGHTS}

_Fields = tuple[FieldRule, ...]


@dataclass(frozen=True)
class _TopicFilter:
    """The filter of one topic: fields, or a preset by name; and the levels of what is seen."""

    position: SourcePosition
    fields: _Fields = ()
    preset: str | None = None
    see: TopicLevels | None = None


class RuleReader:
    """Reads rules in the context of the policy."""

    def __init__(
        self,
        mistakes: Mistakes,
        defaults: Defaults,
        subjects: Subjects,
        types: Mapping[str, str],
        layouts: Mapping[str, Layout],
        filters: Mapping[str, _Fields],
        vocabulary: Vocabulary,
    ) -> None:
        self._mistakes = mistakes
        self._defaults = defaults
        self._subjects = subjects
        self._types = types
        self._layouts = layouts
        self._filters = filters
        self._vocabulary = vocabulary

    def read(self, part: Part) -> PolicyRule | None:
        """One rule, or None if its structure is invalid."""
        mapping = readers.mapping(part, "a rule", self._mistakes)
        if mapping is None:
            return None
        name = readers.text(mapping.get("id"), "id", self._mistakes) or "?"
        if name != "?" and _ID.fullmatch(name) is None:
            self._mistakes.add(mapping, f"not an id: {name[:60]!r}", "letters, digits and dashes")
        readers.check_keys(mapping, f"rule {name}", _KEYS, ("id", "who"), self._mistakes)
        effect, rights = self._effect(mapping, name)
        if effect is None or rights is None:
            return None
        lifetime = readers.duration(mapping.get("lifetime"), "lifetime", self._mistakes)
        renew = readers.duration(
            mapping.get("renew_until"), "renew_until", self._mistakes, never=True
        )
        stale = readers.choice(mapping.get("on_stale"), "on_stale", _ON_STALE, self._mistakes)
        return PolicyRule(
            id=name,
            effect=effect,
            who=self._subjects.read(mapping.get("who")),
            exceptions=self._subjects.read(mapping.get("except")),
            why=readers.text(mapping.get("why"), "why", self._mistakes) or "",
            clauses=self._clauses(mapping, rights, name),
            lifetime=self._defaults.lifetime if lifetime is None else lifetime,
            renew_until=self._defaults.renew_until if renew is None else renew,
            has_lifetime=lifetime is not None,
            keep_when_stale=stale == "keep",
            line=mapping.line,
        )

    def _effect(self, mapping: YamlMapping, name: str) -> tuple[Effect | None, YamlMapping | None]:
        effects = [effect for effect in Effect if effect.value in mapping.entries]
        if len(effects) != 1:
            hint = (
                "write it as two rules" if effects else "for example allow: {subscribe: [/topic]}"
            )
            self._mistakes.add(mapping, f"rule {name} needs one of allow, deny and prompt", hint)
            return None, None
        [effect] = effects
        for key in _RESTRICTING if effect is Effect.DENY else ():
            if key in mapping.entries:
                position = mapping.entries[key][0]
                message = f"rule {name}: a deny rule cannot have {key!r}"
                self._mistakes.add(position, message, "remove it, or write an allow rule")
        rights = mapping.get(effect.value)
        return effect, readers.mapping(rights, f"{effect.value} of rule {name}", self._mistakes)

    def _clauses(self, mapping: YamlMapping, rights: YamlMapping, name: str) -> tuple[Clause, ...]:
        named = self._named_rights(rights, name)
        read = [read_condition(item, self._mistakes) for item in readers.items(mapping.get("when"))]
        conditions = [when for when in read if when is not None]
        seen = [pattern for right, pattern, _ in named if right is Right.SUBSCRIBE]
        filtered = Right.SUBSCRIBE if seen else Right.PUBLISH
        topics = [pattern for right, pattern, _ in named if right is filtered]
        filters = self._filters_of(mapping.get("filter"), topics, name, filtered)
        for topic, see in read_see(mapping.get("see"), seen, name, self._mistakes).items():
            filters[topic] = replace(filters.get(topic, _TopicFilter(see.position)), see=see)
        limit = read_limit(mapping.get("limit"), topics, name, self._mistakes, seen=bool(seen))
        if not seen:
            self._check_written(filters)
        clauses: list[Clause] = []
        for right, pattern, position in named:
            if right is filtered:
                clauses += self._clause(right, pattern, position, conditions, filters, limit)
            else:
                clauses += self._clause(right, pattern, position, conditions, {}, Limit())
        restricting = conditions or filters or any(limit) or mapping.get("on_stale") is not None
        if restricting and any(right & ~MESSAGE_RIGHTS for right, _, _ in named):
            self._mistakes.add(
                rights,
                f"rule {name}: parameters, graph and admin rights cannot have restrictions",
                "put these rights into a separate rule",
            )
        return tuple(clauses)

    def _check_written(self, filters: Mapping[str, _TopicFilter]) -> None:
        """Filters of what is published: its receivers apply them, and have no keys for it."""
        for each in filters.values():
            if each.preset is not None or key_names(item.rule for item in each.fields):
                self._mistakes.add(
                    each.position,
                    "a preset or a pseudonym is for what is subscribed to, not published",
                    "name the fields and their treatment, or add a subscribe right",
                )

    def _named_rights(
        self, rights: YamlMapping, name: str
    ) -> list[tuple[Right, str, SourcePosition]]:
        """Every right and pattern in the rule."""
        if not rights.entries:
            self._mistakes.add(rights, f"rule {name} has no rights", suggest("", RIGHTS))
        found: list[tuple[Right, str, SourcePosition]] = []
        for label, (key, value) in rights.entries.items():
            if label not in RIGHTS:
                message = f"unknown right {label[:60]!r} in rule {name}"
                self._mistakes.add(key, message, suggest(label, RIGHTS))
                continue
            items = readers.items(value)
            if not items:
                self._mistakes.add(value, f"rule {name}: {label} has no names", "add a name")
            for item in items:
                pattern = readers.own_pattern(item, label, RIGHTS[label], self._mistakes)
                if pattern is not None:
                    found.append((RIGHTS[label], pattern, item))
        return found

    def _clause(
        self,
        right: Right,
        pattern: str,
        position: SourcePosition,
        conditions: list[ConditionRule],
        filters: Mapping[str, _TopicFilter],
        limit: Limit,
    ) -> list[Clause]:
        topic_filter = filters.get(pattern, _TopicFilter(position))
        kind = type_of(self._types, pattern)
        reads_message = (
            topic_filter.fields
            or topic_filter.preset
            or topic_filter.see
            or any(when.reads_message for when in conditions)
        )
        if reads_message and not self._fits(
            right, pattern, position, kind, conditions, topic_filter
        ):
            return []
        levels = self._levels(topic_filter, pattern, kind)
        if levels is None:
            return []
        own = Resolved((), limit.rate, limit.slot)
        given = self._treatment(topic_filter, kind, own, levels)
        limits = (given.slot, limit.body, limit.pad)
        if not conditions and not given.rules and limits == (None, None, None):
            return [Clause(right, pattern, None, given.rate, kind)]
        try:
            if limit.body is not None and given.slot is None:
                raise GrantMalformed(
                    f"without a slot the body {limit.body} cannot be told in common",
                    "for example limit: {slot: 30}",
                )
            texts = tuple(dict.fromkeys(when.text for when in conditions))
            restriction = Restriction(
                kind if reads_message else None, texts, given.rules, slot=given.slot,
                body=limit.body, pad=limit.pad,
            )  # fmt: skip
            entry = Permission(any_node(pattern), right, replace(restriction, rate=given.rate))
            if reason := why_unsignable((entry,)):
                raise GrantMalformed(reason, "write fewer or shorter conditions and filters")
        except GrantError as error:
            self._mistakes.add(position, f"{right.label} {pattern}: {error}", error.hint)
            return []
        return [Clause(right, pattern, restriction, given.rate, kind)]

    def _levels(
        self, topic_filter: _TopicFilter, pattern: str, kind: str | None
    ) -> Resolved | None:
        """What `see` of the rule adds for one topic; None if it does not fit."""
        if topic_filter.see is None or kind is None:
            return Resolved()
        layout = self._layouts[kind]
        others = self._treatment(topic_filter, kind).rules
        see = topic_filter.see
        return resolve_levels(layout, self._vocabulary, pattern, see, others, self._mistakes)

    def _treatment(
        self, topic_filter: _TopicFilter, kind: str | None, *given: Resolved
    ) -> Resolved:
        """The rules, the lowest rate and the longest slot of the filter and of these."""
        found = [Resolved(tuple(item.rule for item in topic_filter.fields)), *given]
        if topic_filter.preset is not None and kind is not None:
            named = preset(topic_filter.preset).restriction(self._layouts[kind])
            found.append(Resolved(named.filters, named.rate, named.slot))
        return together(found)

    def _fits(
        self, right: Right, pattern: str, position: SourcePosition, kind: str | None,
        conditions: list[ConditionRule], topic_filter: _TopicFilter,
    ) -> bool:  # fmt: skip
        """Whether conditions and filters on messages of `pattern` fit their type."""
        if not right & (Right.SUBSCRIBE | Right.PUBLISH):
            message = f"{right.label} {pattern}: conditions on messages are for topics"
            self._mistakes.add(position, message, "put this right into a separate rule")
            return False
        if kind is None:
            message = f"the message type of {pattern} is unknown"
            hint = f"add it to types: {{{pattern.replace(NODE, '~')}: package/Type}}"
            self._mistakes.add(position, message, hint)
            return False
        if kind not in self._layouts:
            return False  # the type itself is the mistake, and recorded
        layout = self._layouts[kind]
        checked = [check_condition(layout, when, self._mistakes) for when in conditions]
        if topic_filter.preset is not None:
            checked.append(
                check_preset(layout, topic_filter.preset, topic_filter.position, self._mistakes)
            )
        if topic_filter.fields:
            checked.append(
                check_fields(layout, topic_filter.fields, topic_filter.position, self._mistakes)
            )
        return all(checked)

    def _filters_of(
        self, part: Part | None, topics: list[str], name: str, right: Right
    ) -> dict[str, _TopicFilter]:
        """The filter of every topic: `{use: NAME}`, fields, or either of them by topic."""
        mapping = readers.mapping(part, f"filter of rule {name}", self._mistakes)
        if mapping is None:
            return {}
        if not topics or not mapping.entries:
            hint = "add a subscribe or publish right, or remove the filter"
            self._mistakes.add(mapping, f"rule {name}: nothing to filter", hint)
            return {}
        if not any(key.startswith(BEGINS_TOPIC) for key in mapping.entries):
            return dict.fromkeys(topics, self._topic_filter(mapping, mapping))
        found: dict[str, _TopicFilter] = {}
        what = f"filter of rule {name}"
        for topic, key, value in readers.by_name(
            mapping, what, lambda key: readers.pattern(key, what, self._mistakes), self._mistakes
        ):
            if topic not in topics:
                message = f"rule {name} has no {right.label} right on {topic[:80]!r}"
                self._mistakes.add(key, message, suggest(topic, topics))
                continue
            inner = readers.mapping(value, f"filter of {topic}", self._mistakes)
            if inner is not None:
                found[topic] = self._topic_filter(key, inner)
        return found

    def _topic_filter(self, position: SourcePosition, mapping: YamlMapping) -> _TopicFilter:
        """Fields, or `{use: NAME}` of a filter of this policy or else of a preset."""
        if "use" not in mapping.entries:
            return _TopicFilter(position, read_fields(mapping, self._mistakes))
        readers.check_keys(mapping, "a filter with use", ("use",), (), self._mistakes)
        known = {**PRESETS, **self._filters}
        name = readers.choice(mapping.get("use"), "filter", known, self._mistakes)
        if name is None or name in self._filters:
            return _TopicFilter(position, self._filters.get(name or "", ()))
        return _TopicFilter(position, preset=name)
