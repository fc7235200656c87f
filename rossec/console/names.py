"""What the policy calls things, for pages: titles of nodes and topics, and types of topics. Pure.

A title is never shown without the name of ROS beside it: it is a help to people, who decide by the
name. Both come from the authority's policy, and no node can choose its own.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from grants.policy.model import type_of
from rossec.authority.console.views import PolicyName
from rossec.console import words
from rossec.ros.text import printable

MAX_TITLE: Final = 60


@dataclass(frozen=True)
class Names:
    """Titles by name, as the name is and as it is shown; types by topic or pattern."""

    titles: dict[str, str] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Iterable[PolicyName]) -> "Names":
        """Those of a policy."""
        titles: dict[str, str] = {}
        types: dict[str, str] = {}
        for each in found:
            if each.type:
                types[each.name] = each.type
            if each.title:
                title = printable(each.title, MAX_TITLE)
                titles |= dict.fromkeys((each.name, words.topic(each.name)), title)
        return cls(titles, types)

    def title(self, name: str) -> str:
        """The title of a node or a topic, by its name as it is or as it is shown; maybe empty."""
        return self.titles.get(name, "")

    def type_of(self, topic: str) -> str:
        """The type of a topic's messages, by the policy; empty: it does not say."""
        return type_of(self.types, topic) or ""


NONE: Final = Names()
