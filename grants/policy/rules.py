"""One rule of a policy: its subjects, its rights on names, and their restrictions; and the rule of `basics`.

A group (`groups: {robots: [/robot1, /robot2]}`) stands for its members wherever a rule says `who` or
`except`; it may name other groups, never itself. Identities and groups share one space of names: a word means
one thing.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from grants.errors import GrantError, GrantMalformed
from grants.filters.compile import PRESETS, preset
from grants.filters.hashing import key_names
from grants.filters.layout import Layout
from grants.model import ALL_RIGHTS, MESSAGE_RIGHTS, Permission, Restriction, Right
from grants.policy import source
from grants.policy.model import (
    EVERYONE,
    Clause,
    Defaults,
    Effect,
    PolicyRule,
    SubjectPattern,
    Vocabulary,
    type_of,
)
from grants.policy.names import BEGINS_TOPIC, NODE, any_node
from grants.policy.restrictions import (
    ConditionRule,
    FieldRule,
    Limit,
    TopicLevels,
    check_condition,
    check_fields,
    check_preset,
    read_condition,
    read_fields,
    read_limit,
    read_see,
    resolve_levels,
    why_unsignable,
)
from grants.policy.source import Part, YamlMapping, YamlScalar, suggest
from grants.request import BASICS, TRANSFORMS
from grants.vocabulary.levels import Resolved, together

MAX_MEMBERS: Final = 1000  # of one group, with those of the groups in it
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,79}", re.ASCII)

_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}", re.ASCII)
_EFFECTS: Final = tuple(effect.value for effect in Effect)
_RESTRICTING: Final = ("when", "filter", "see", "limit", "on_stale", "lifetime", "renew_until")
_KEYS: Final = ("id", "why", "who", "except", *_EFFECTS, *_RESTRICTING)
RIGHTS: Final = {right.label: right for right in ALL_RIGHTS}

_Members = tuple[SubjectPattern, ...]
_Fields = tuple[FieldRule, ...]


class Subjects:
    def __init__(self, identities: Mapping[str, SubjectPattern], part: Part | None) -> None:
        self._identities = identities
        self._parts = dict(self._named(part))
        self._within: dict[str, frozenset[str]] = {}  # the groups in each, itself among them
        self._used: set[str] = set()
        self.groups: dict[str, _Members] = {}  # the members of each, without groups
        for name in self._parts:
            self._members_of(name, ())

    @property
    def unused(self) -> tuple[str, ...]:
        # The groups that no rule names, also not through another group.
        return tuple(sorted(self.groups.keys() - self._used))

    def read(self, part: Part | None) -> _Members:
        return tuple(who for item in source.items(part) for who in self._subjects(item))

    def _subjects(self, part: Part) -> Iterable[SubjectPattern]:
        label = source.text(part, "who")
        if label is None:
            return ()
        if label == EVERYONE:
            return (SubjectPattern(label, "/**"),)
        if label in self.groups:
            self._used |= self._within[label]
            return (replace(who, group=label) for who in self.groups[label])
        return self._single(part, label)

    def _single(self, part: Part, label: str) -> _Members:
        if label.startswith("/") or ":" in label:
            node = source.subject(part, "who")
            return () if node is None else (SubjectPattern(label, node),)
        if label in self._identities:
            return (self._identities[label],)
        if label.startswith(("~", "{")):
            hint = f"{NODE} stands in the names of a rule; who it is for is a name: /robot1"
            part.mistake(f"{label[:60]!r} is no node", hint)
            return ()
        known = {**self._identities, **self._parts}
        hint = suggest(label, known) if known else f"a node is written /{label.lstrip('/')[:60]}"
        part.mistake(f"unknown identity {label[:60]!r}", hint)
        return ()

    def _named(self, part: Part | None) -> Iterator[tuple[str, Part]]:
        # The groups by name, those with a wrong name too, so that rules report no more.
        for name, key, value in source.entries(part, "groups"):
            if name in self._identities:
                key.mistake(f"{name!r} is an identity already", "choose another name")
            elif _NAME.fullmatch(name) is None or name == NODE[1:-1]:
                hint = "begin with a letter, then letters, digits, - and _; not node"
                key.mistake(f"{name[:60]!r} cannot be the name of a group", hint)
            yield name, value

    def _members_of(self, name: str, above: tuple[str, ...]) -> _Members:
        if name not in self.groups:
            self.groups[name], self._within[name] = (), frozenset({name})
            found: dict[SubjectPattern, None] = {}
            for item in source.items(self._parts[name]):
                found.update(dict.fromkeys(self._item(item, (*above, name))))
            part = self._parts[name]
            if len(found) > MAX_MEMBERS:
                hint = "give the nodes a namespace of their own: /robots/*"
                part.mistake(f"group {name} has more than {MAX_MEMBERS} members", hint)
            if not source.items(part):
                part.mistake(f"group {name} has no members", "add a name: [/robot1]")
            self.groups[name] = tuple(found)
        return self.groups[name]

    def _item(self, part: Part, above: tuple[str, ...]) -> _Members:
        label = source.text(part, f"a member of group {above[-1]}")
        if label is None:
            return ()
        if label in above:
            chain = ", ".join((*above[above.index(label) :], label))
            part.mistake(f"group {label} is a member of itself: {chain}", "name the nodes in one of them")
            return ()
        if label == EVERYONE:
            hint = f"write who: {EVERYONE!r} in the rule"
            part.mistake(f"group {above[-1]}: {EVERYONE} is every node", hint)
            return ()
        if label in self._parts:
            members = self._members_of(label, above)
            self._within[above[-1]] |= self._within[label]
            return members
        return self._single(part, label)


class _Named(NamedTuple):
    right: Right
    pattern: str
    position: Part

    def mistake(self, message: str, hint: str) -> None:
        self.position.mistake(f"{self.right.label} {self.pattern}: {message}", hint)


def _named_rights(rights: YamlMapping, name: str) -> Iterator[_Named]:
    if not rights.entries:
        rights.mistake(f"rule {name} has no rights", suggest("", RIGHTS))
    for label, (key, value) in rights.entries.items():
        if label not in RIGHTS:
            key.mistake(f"unknown right {label[:60]!r} in rule {name}", suggest(label, RIGHTS))
            continue
        if not source.items(value):
            value.mistake(f"rule {name}: {label} has no names", "add a name")
        for item in source.items(value):
            pattern = source.own_pattern(item, label, RIGHTS[label])
            if pattern is not None:
                yield _Named(RIGHTS[label], pattern, item)


@dataclass(frozen=True)
class _TopicFilter:
    position: Part
    fields: _Fields = ()
    preset: str | None = None
    see: TopicLevels | None = None


@dataclass
class RuleReader:
    _defaults: Defaults
    _subjects: Subjects
    _types: Mapping[str, str]
    _layouts: Mapping[str, Layout]
    _filters: Mapping[str, _Fields]
    _vocabulary: Vocabulary

    def read(self, part: Part) -> PolicyRule | None:
        mapping = source.mapping(part, "a rule")
        if mapping is None:
            return None
        name = source.text(mapping.get("id"), "id") or "?"
        if name != "?" and _ID.fullmatch(name) is None:
            mapping.mistake(f"not an id: {name[:60]!r}", "letters, digits and dashes")
        source.check_keys(mapping, f"rule {name}", _KEYS, ("id", "who"))
        effects = [effect for effect in Effect if effect.value in mapping.entries]
        if len(effects) != 1:
            hint = "write it as two rules" if effects else "for example allow: {subscribe: [/topic]}"
            mapping.mistake(f"rule {name} needs one of allow, deny and prompt", hint)
            return None
        [effect] = effects
        for key in _RESTRICTING if effect is Effect.DENY else ():
            if key in mapping.entries:
                message = f"rule {name}: a deny rule cannot have {key!r}"
                mapping.entries[key][0].mistake(message, "remove it, or write an allow rule")
        rights = source.mapping(mapping.get(effect.value), f"{effect.value} of rule {name}")
        if rights is None:
            return None
        lifetime = source.duration(mapping.get("lifetime"), "lifetime")
        renew = source.duration(mapping.get("renew_until"), "renew_until", never=True)
        stale = source.choice(mapping.get("on_stale"), "on_stale", ("cut", "keep"))
        return PolicyRule(
            id=name,
            effect=effect,
            who=self._subjects.read(mapping.get("who")),
            exceptions=self._subjects.read(mapping.get("except")),
            why=source.text(mapping.get("why"), "why") or "",
            clauses=self._clauses(mapping, rights, name),
            lifetime=self._defaults.lifetime if lifetime is None else lifetime,
            renew_until=self._defaults.renew_until if renew is None else renew,
            has_lifetime=lifetime is not None,
            keep_when_stale=stale == "keep",
            line=mapping.line,
        )

    def _clauses(self, mapping: YamlMapping, rights: YamlMapping, name: str) -> tuple[Clause, ...]:
        named = list(_named_rights(rights, name))
        read = (read_condition(item) for item in source.items(mapping.get("when")))
        conditions = [when for when in read if when is not None]
        seen = [each.pattern for each in named if each.right is Right.SUBSCRIBE]
        filtered = Right.SUBSCRIBE if seen else Right.PUBLISH
        topics = [each.pattern for each in named if each.right is filtered]
        filters = self._filters_of(mapping.get("filter"), topics, name, filtered)
        for topic, see in read_see(mapping.get("see"), seen, name).items():
            filters[topic] = replace(filters.get(topic, _TopicFilter(see.position)), see=see)
        limit = read_limit(mapping.get("limit"), topics, name, seen=bool(seen))
        for given in filters.values() if not seen else ():
            if given.preset is not None or key_names(item.rule for item in given.fields):
                message = "a preset or a pseudonym is for what is subscribed to, not published"
                hint = "name the fields and their treatment, or add a subscribe right"
                given.position.mistake(message, hint)
        # For every topic separately, against its type: a filter that fits one of two is a mistake, not half a
        # filter.
        clauses: list[Clause] = []
        for each in named:
            none = _TopicFilter(each.position)
            mine = (filters.get(each.pattern, none), limit) if each.right is filtered else (none, Limit())
            clauses += self._clause(each, conditions, *mine)
        restricting = conditions or filters or any(limit) or mapping.get("on_stale") is not None
        if restricting and any(each.right & ~MESSAGE_RIGHTS for each in named):
            message = f"rule {name}: parameters, graph and admin rights cannot have restrictions"
            rights.mistake(message, "put these rights into a separate rule")
        return tuple(clauses)

    def _clause(
        self, named: _Named, conditions: list[ConditionRule], topic_filter: _TopicFilter, limit: Limit
    ) -> list[Clause]:
        right, pattern, _ = named
        kind = type_of(self._types, pattern)
        treated = topic_filter.fields or topic_filter.preset or topic_filter.see
        reads_message = treated or any(when.reads_message for when in conditions)
        if reads_message and not self._fits(named, kind, conditions, topic_filter):
            return []
        levels = self._levels(topic_filter, pattern, kind)
        if levels is None:
            return []
        given = self._treatment(topic_filter, kind, Resolved((), limit.rate, limit.slot), levels)
        limits = (given.slot, limit.body, limit.pad)
        if not conditions and not given.rules and limits == (None, None, None):
            return [Clause(right, pattern, None, given.rate, kind)]
        try:
            if limit.body is not None and given.slot is None:
                message = f"without a slot the body {limit.body} cannot be told in common"
                raise GrantMalformed(message, "for example limit: {slot: 30}")
            texts = tuple(dict.fromkeys(when.text for when in conditions))
            of = kind if reads_message else None
            restriction = Restriction(of, texts, given.rules, slot=given.slot, body=limit.body, pad=limit.pad)
            entry = Permission(any_node(pattern), right, replace(restriction, rate=given.rate))
            if reason := why_unsignable((entry,)):
                raise GrantMalformed(reason, "write fewer or shorter conditions and filters")
        except GrantError as error:
            named.mistake(str(error), error.hint)
            return []
        return [Clause(right, pattern, restriction, given.rate, kind)]

    def _levels(self, topic_filter: _TopicFilter, pattern: str, kind: str | None) -> Resolved | None:
        # What `see` of the rule adds for one topic; None if it does not fit.
        if topic_filter.see is None or kind is None:
            return Resolved()
        others = self._treatment(topic_filter, kind).rules
        layout, see = self._layouts[kind], topic_filter.see
        return resolve_levels(layout, self._vocabulary, pattern, see, others)

    def _treatment(self, topic_filter: _TopicFilter, kind: str | None, *given: Resolved) -> Resolved:
        found = [Resolved(tuple(item.rule for item in topic_filter.fields)), *given]
        if topic_filter.preset is not None and kind is not None:
            named = preset(topic_filter.preset).restriction(self._layouts[kind])
            found.append(Resolved(named.filters, named.rate, named.slot))
        return together(found)

    def _fits(
        self, named: _Named, kind: str | None, conditions: list[ConditionRule], topic_filter: _TopicFilter
    ) -> bool:
        if not named.right & (Right.SUBSCRIBE | Right.PUBLISH):
            named.mistake("conditions on messages are for topics", "put this right into a separate rule")
            return False
        if kind is None:
            hint = f"add it to types: {{{named.pattern.replace(NODE, '~')}: package/Type}}"
            named.position.mistake(f"the message type of {named.pattern} is unknown", hint)
            return False
        if kind not in self._layouts:
            return False  # the type itself is the mistake, and recorded
        layout, at = self._layouts[kind], topic_filter.position
        checked = [check_condition(layout, when) for when in conditions]
        if topic_filter.preset is not None:
            checked.append(check_preset(layout, topic_filter.preset, at))
        if topic_filter.fields:
            checked.append(check_fields(layout, topic_filter.fields, at))
        return all(checked)

    def _filters_of(
        self, part: Part | None, topics: list[str], name: str, right: Right
    ) -> dict[str, _TopicFilter]:
        mapping = source.mapping(part, f"filter of rule {name}")
        if mapping is None:
            return {}
        if not topics or not mapping.entries:
            hint = "add a subscribe or publish right, or remove the filter"
            mapping.mistake(f"rule {name}: nothing to filter", hint)
            return {}
        if not any(key.startswith(BEGINS_TOPIC) for key in mapping.entries):
            return dict.fromkeys(topics, self._topic_filter(mapping, mapping))
        found = source.by_topic(mapping, "filter", name, topics, right)
        return {topic: self._topic_filter(key, inner) for topic, (key, inner) in found.items()}

    def _topic_filter(self, position: Part, mapping: YamlMapping) -> _TopicFilter:
        if "use" not in mapping.entries:
            return _TopicFilter(position, read_fields(mapping))
        source.check_keys(mapping, "a filter with use", ("use",), ())
        known = {**PRESETS, **self._filters}
        name = source.choice(mapping.get("use"), "filter", known)
        if name is None or name in self._filters:
            return _TopicFilter(position, self._filters.get(name or "", ()))
        return _TopicFilter(position, preset=name)


# `basics` of a policy: one more rule, which gives every node what every ROS program needs. `basics: true`
# is the table of `grants.request`; `basics: [tf]` also lets every node subscribe to the transforms. A
# denial overrides it, and `explain` names it.
ID: Final = "basics"
EXTRAS: Final = {"tf": (Right.SUBSCRIBE, TRANSFORMS)}


def read_basics(part: Part | None) -> tuple[str, ...] | None:
    # What it adds to the table: `tf`, or nothing; None without basics.
    if part is None or (isinstance(part, YamlScalar) and part.value is False):
        return None
    if isinstance(part, YamlScalar) and part.value is True:
        return ()
    items = source.items(part)
    if not items or isinstance(part, YamlScalar):
        hint = "write basics: true, or basics: [tf] for the transforms too"
        part.mistake("basics is true, false or a list", hint)
        return None
    found = (source.choice(item, "part of basics", EXTRAS) for item in items)
    return tuple(dict.fromkeys(name for name in found if name is not None))


def basics_rule(
    extras: Iterable[str], line: int, defaults: Defaults, rules: Iterable[PolicyRule]
) -> PolicyRule:
    clauses = [Clause(right, name) for right, names in BASICS.items() for name in names]
    for extra in extras:
        right, names = EXTRAS[extra]
        clauses += [Clause(right, name) for name in names]
    lasting = [each for each in rules if each.effect is not Effect.DENY]
    # It lasts as long as the longest rule: else it would shorten the grants of wide rules, such as
    # `param-get: /**`.
    return PolicyRule(
        ID,
        Effect.ALLOW,
        (SubjectPattern(EVERYONE, "/**"),),
        tuple(clauses),
        "what every ROS program needs",
        lifetime=max((each.lifetime for each in lasting), default=defaults.lifetime),
        renew_until=max((each.renew_until for each in lasting), default=defaults.renew_until),
        has_lifetime=True,
        line=line,
    )


def is_basics(rule: PolicyRule) -> bool:
    """Whether the rule is that of `basics`, and gives nothing that is not of the table."""
    table = {(right, name) for right, names in (*BASICS.items(), *EXTRAS.values()) for name in names}
    return rule.id == ID and {(each.right, each.pattern) for each in rule.clauses} <= table
