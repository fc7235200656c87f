"""Who a rule is for: names and patterns, nodes of other domains, identities, and groups of these.

A group is a list under a name (`groups: {robots: [/robot1, /robot2]}`) and may name other groups,
never itself. It stands for its members wherever a rule says `who` or `except`; nothing else is a
member. Identities and groups share one space of names, so that a word means one thing.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from grants.policy import readers
from grants.policy.mistakes import Mistakes, suggest
from grants.policy.model import EVERYONE, SubjectPattern
from grants.policy.own_names import NODE
from grants.policy.source import Part, YamlMapping, YamlScalar

MAX_MEMBERS: Final = 1000  # of one group, with those of the groups in it
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,79}", re.ASCII)

_Members = tuple[SubjectPattern, ...]


class Subjects:
    """Reads subjects in the context of the identities and groups of one policy.

    Attributes:
        groups: the members of each group, without groups.
    """

    def __init__(
        self, mistakes: Mistakes, identities: Mapping[str, SubjectPattern], part: Part | None
    ) -> None:
        self._mistakes = mistakes
        self._identities = identities
        self._parts = dict(self._named(readers.mapping(part, "groups", mistakes)))
        self._within: dict[str, frozenset[str]] = {}  # the groups in each, itself among them
        self._used: set[str] = set()
        self.groups: dict[str, _Members] = {}
        for name in self._parts:
            self._members_of(name, ())

    @property
    def unused(self) -> tuple[str, ...]:
        """The groups that no rule names, also not through another group."""
        return tuple(sorted(self.groups.keys() - self._used))

    def read(self, part: Part | None) -> _Members:
        """The subjects of a rule, each member of a group with the name of the group."""
        return tuple(who for item in readers.items(part) for who in self._subjects(item))

    def _subjects(self, part: Part) -> Iterable[SubjectPattern]:
        label = readers.text(part, "who", self._mistakes)
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
            node = readers.subject(part, "who", self._mistakes)
            return () if node is None else (SubjectPattern(label, node),)
        if label in self._identities:
            return (self._identities[label],)
        if label.startswith(("~", "{")):
            hint = f"{NODE} stands in the names of a rule; who it is for is a name: /robot1"
            self._mistakes.add(part, f"{label[:60]!r} is no node", hint)
            return ()
        known = {**self._identities, **self._parts}
        hint = suggest(label, known) if known else f"a node is written /{label.lstrip('/')[:60]}"
        self._mistakes.add(part, f"unknown identity {label[:60]!r}", hint)
        return ()

    def _named(self, mapping: YamlMapping | None) -> Iterator[tuple[str, Part]]:
        """The groups by name, those with a wrong name too, so that rules report no more."""
        for name, (key, value) in mapping.entries.items() if mapping is not None else ():
            self._check_name(name, key)
            yield name, value

    def _check_name(self, name: str, key: YamlScalar) -> None:
        if name in self._identities:
            self._mistakes.add(key, f"{name!r} is an identity already", "choose another name")
        elif _NAME.fullmatch(name) is None or name == NODE[1:-1]:
            hint = "begin with a letter, then letters, digits, - and _; not node"
            self._mistakes.add(key, f"{name[:60]!r} cannot be the name of a group", hint)

    def _members_of(self, name: str, above: tuple[str, ...]) -> _Members:
        """The members of a group, read once; `above` are the groups that are being read."""
        if name not in self.groups:
            self.groups[name], self._within[name] = (), frozenset({name})
            found: dict[SubjectPattern, None] = {}
            for item in readers.items(self._parts[name]):
                found.update(dict.fromkeys(self._item(item, (*above, name))))
            self._check_number(name, len(found))
            self.groups[name] = tuple(found)
        return self.groups[name]

    def _item(self, part: Part, above: tuple[str, ...]) -> _Members:
        label = readers.text(part, f"a member of group {above[-1]}", self._mistakes)
        if label is None:
            return ()
        if label in above:
            chain = ", ".join((*above[above.index(label) :], label))
            message = f"group {label} is a member of itself: {chain}"
            self._mistakes.add(part, message, "name the nodes in one of them")
            return ()
        if label == EVERYONE:
            hint = f"write who: {EVERYONE!r} in the rule"
            self._mistakes.add(part, f"group {above[-1]}: {EVERYONE} is every node", hint)
            return ()
        if label in self._parts:
            members = self._members_of(label, above)
            self._within[above[-1]] |= self._within[label]
            return members
        return self._single(part, label)

    def _check_number(self, name: str, number: int) -> None:
        part = self._parts[name]
        if number > MAX_MEMBERS:
            hint = "give the nodes a namespace of their own: /robots/*"
            self._mistakes.add(part, f"group {name} has more than {MAX_MEMBERS} members", hint)
        if not readers.items(part):
            self._mistakes.add(part, f"group {name} has no members", "add a name: [/robot1]")
