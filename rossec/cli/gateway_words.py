"""What stands behind each `--from` of `rossec gateway`: a label, patterns, and how they come. Pure.

`--rate`, `--newest` and `--compress` are about the patterns of the `--from` before them; another
`--from`, of the same domain too, begins anew. Any other option ends it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import click

from rossec.gateway import MAX_RULES, TopicRule, rule
from rossec.participant.delivery_options import DeliveryOptions

FROM: Final = "--from"
RATE: Final = "--rate"
NEWEST: Final = "--newest"
COMPRESS: Final = "--compress"


@dataclass
class _Group:
    label: str
    patterns: list[str] = field(default_factory=list)
    rate: float | None = None
    newest: bool = False
    compress: bool = False

    def rules(self) -> Iterator[TopicRule]:
        if "/" in self.label:
            raise click.UsageError(f"{FROM} takes a label, and then patterns: {FROM} hospital /robot/pose")
        if not self.patterns:
            raise click.UsageError(f"{FROM} {self.label} names no topics: {FROM} {self.label} /robot/pose")
        options = DeliveryOptions(self.rate, self.newest, self.compress)
        return (rule(self.label, pattern, options) for pattern in self.patterns)


def split(words: Sequence[str]) -> tuple[tuple[TopicRule, ...], list[str]]:
    """The rules in a command line, and its other words."""
    groups, rest, left = list[_Group](), list[str](), iter(words)
    current: _Group | None = None
    for word in left:
        # Not by click, whose options are of the command: these are of the --from before them.
        option, equals, value = word.partition("=")
        if option == FROM:
            current = _Group(value if equals else _next(left, option))
            groups.append(current)
        elif current is not None and option == RATE:
            current.rate = _number(value if equals else _next(left, option))
        elif current is not None and word == NEWEST:
            current.newest = True
        elif current is not None and word == COMPRESS:
            current.compress = True
        elif current is not None and not word.startswith("-"):
            current.patterns.append(word)
        else:
            current = None
            rest.append(word)
    rules = tuple(each for group in groups for each in group.rules())
    if len(rules) > MAX_RULES:
        raise click.UsageError(f"{len(rules)} patterns: at most {MAX_RULES}")
    return rules, rest


def _next(left: Iterator[str], option: str) -> str:
    word = next(left, "-")
    if word.startswith("-"):
        raise click.UsageError(f"{option} needs a value: {FROM} hospital /robot/pose {RATE} 5")
    return word


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise click.UsageError(f"{RATE} takes messages a second, not {word[:40]!a}") from None
