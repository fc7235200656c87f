"""Rules tried on the metadata of many nodes: what would go wrong with them, and where.

Found are metadata that cannot be read, names that are none, reserved or covered by no right, one name for two
things, and names that change with the order of the metadata: the elements of a node say what they are by
their tags, not by their place.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final
from xml.etree import ElementTree

from rossec.errors import MetadataRefused, NameUndefined, ProposedNameRefused, RossecError, RulesNotConfined
from rossec.naming import requests
from rossec.naming.requests import NameKind, Result, parse
from rossec.naming.rule_runner import RuleRunner

_ALL: Final = 4  # up to so many elements all orders are tried
_ROTATIONS: Final = 8
_LABELS: Final = {ProposedNameRefused: "illegal", NameUndefined: "undefined", MetadataRefused: "metadata"}

Covered = Callable[[str, NameKind, str], bool]
"""Whether the node with the first name may use what has the second one in any way."""


@dataclass(frozen=True, order=True)
class MetadataFinding:
    file: str
    line: int
    what: str  # `metadata`, `undefined`, `illegal`, `rules`, `collision`, `order` or `uncovered`
    message: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.message}"


@dataclass(frozen=True)
class MetadataPlace:
    file: str
    line: int
    kind: NameKind
    which: str

    @property
    def label(self) -> str:
        return f"the {self.kind} {self.which}".rstrip()


@dataclass
class MetadataReport:
    """What was found, sorted, and by kind and name all places that get this name."""

    findings: list[MetadataFinding] = field(default_factory=list)
    names: dict[tuple[NameKind, str], list[MetadataPlace]] = field(default_factory=dict)


async def examine(
    rules: RuleRunner, documents: Iterable[tuple[str, bytes]], covered: Covered | None = None
) -> MetadataReport:
    report = MetadataReport()
    for file, document in documents:
        try:
            await _examine_one(rules, file, document, covered, report)
        except RulesNotConfined:
            raise
        except RossecError as error:
            label = "metadata" if isinstance(error, MetadataRefused) else "rules"
            report.findings.append(MetadataFinding(file, 1, label, str(error)))
    for (_, name), (first, *others) in report.names.items():
        for place in others:
            message = f"{place.label}: {name} is also {first.label} in {first.file}:{first.line}"
            report.findings.append(MetadataFinding(place.file, place.line, "collision", message))
    report.findings.sort()
    return report


async def _examine_one(
    rules: RuleRunner, file: str, document: bytes, covered: Covered | None, report: MetadataReport
) -> None:
    read = requests.read(document)
    entries = [MetadataPlace(file, entry.line, entry.kind, entry.name) for entry in read.entries]
    places, queries = [MetadataPlace(file, 1, NameKind.NODE, ""), *entries], list(read.queries())
    results = await rules.names(document, queries)
    node = results[0] if isinstance(results[0], str) else None
    for place, result in zip(places, results, strict=True):
        if isinstance(result, RossecError):
            label = _LABELS.get(type(result), "rules")
            report.findings.append(MetadataFinding(file, place.line, label, f"{place.label}: {result}"))
            continue
        report.names.setdefault((place.kind, result), []).append(place)
        if covered is not None and node is not None and not covered(node, place.kind, result):
            message = f"{place.label}: no grant or rule covers {result} for {node}"
            report.findings.append(MetadataFinding(file, place.line, "uncovered", message))
    changed: dict[MetadataPlace, MetadataFinding] = {}
    for other in orders(document):
        for place, first, second in zip(places, results, await rules.names(other, queries), strict=True):
            if _text(first) != _text(second) and place not in changed:
                said = f"{_text(first)}, but in another order of the same metadata {_text(second)}"
                changed[place] = MetadataFinding(file, place.line, "order", f"{place.label}: {said}")
    report.findings += changed.values()


def _text(result: Result) -> str:
    return result if isinstance(result, str) else f"no name ({result})"


def orders(document: bytes) -> Iterator[bytes]:
    """The same metadata in other orders, for all of which rules must give the same names."""
    root = parse(document)
    children = list(root)
    inner = [list(child) for child in children]
    seen = {tuple(range(len(children)))}
    longest = max((len(each) for each in inner), default=0)
    for at, order in enumerate(_orders(max(len(children), longest))):
        outer = tuple(index for index in order if index < len(children))
        if outer in seen and longest < 2:
            continue
        seen.add(outer)
        for child, elements in zip(children, inner, strict=True):
            by = (at + 1) // 2 % len(elements) if elements else 0
            child[:] = elements[by:] + elements[:by] if at % 2 else (elements[by:] + elements[:by])[::-1]
        root[:] = [children[index] for index in outer]
        yield ElementTree.tostring(root, encoding="utf-8")


def _orders(count: int) -> Iterator[Sequence[int]]:
    # The given order left out. With few elements all are tried, with more every rotation up to a number,
    # forwards and backwards: each element then was the first, the last, and beside each of its neighbours.
    given = tuple(range(count))
    if count <= _ALL:
        yield from itertools.islice(itertools.permutations(given), 1, None)
        return
    for by in range(min(count, _ROTATIONS)):
        rotated = given[by:] + given[:by]
        if by:
            yield rotated
        yield rotated[::-1]
