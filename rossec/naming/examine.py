"""Rules tried on the metadata of many nodes: what would go wrong with them, and where.

Found are metadata that cannot be read, names that are none, reserved or covered by no right, one
name for two things, and names that change with the order of the metadata.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

from rossec.errors import (
    MetadataRefused,
    NameUndefined,
    ProposedNameRefused,
    RossecError,
    RulesNotConfined,
)
from rossec.naming import metadata
from rossec.naming.frames import Result
from rossec.naming.metadata import Kind, Metadata
from rossec.naming.orders import orders
from rossec.naming.runner import RuleRunner

Covered = Callable[[str, Kind, str], bool]
"""Whether the node with the first name may use what has the second one in any way."""

_LABELS: Final = {
    ProposedNameRefused: "illegal",
    NameUndefined: "undefined",
    MetadataRefused: "metadata",
}


@dataclass(frozen=True, order=True)
class Finding:
    """Something wrong, at a line of a file with metadata.

    `what` is `metadata`, `undefined`, `illegal`, `rules`, `collision`, `order` or `uncovered`.
    """

    file: str
    line: int
    what: str
    message: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.message}"


@dataclass
class Report:
    """What was found, and every name: kind, name, and where it came from."""

    findings: list[Finding] = field(default_factory=list)
    names: dict[tuple[Kind, str], list["Place"]] = field(default_factory=dict)


@dataclass(frozen=True)
class Place:
    """A node, topic or service in metadata."""

    file: str
    line: int
    kind: Kind
    which: str

    @property
    def label(self) -> str:
        """`the node`, `the topic accelerometer`."""
        return f"the {self.kind} {self.which}".rstrip()


async def examine(
    rules: RuleRunner, documents: Iterable[tuple[str, bytes]], covered: Covered | None = None
) -> Report:
    """Try `rules` on `documents`: names of files, and their content.

    Raises:
        RulesNotConfined: no rules can be applied here.
    """
    report, names = Report(), defaultdict[tuple[Kind, str], list[Place]](list)
    for file, document in documents:
        try:
            await _examine_one(rules, file, document, covered, names, report.findings)
        except RulesNotConfined:
            raise
        except RossecError as error:
            label = "metadata" if isinstance(error, MetadataRefused) else "rules"
            report.findings.append(Finding(file, 1, label, str(error)))
    report.names = dict(names)
    report.findings += _collisions(names)
    report.findings.sort()
    return report


async def _examine_one(
    rules: RuleRunner,
    file: str,
    document: bytes,
    covered: Covered | None,
    names: dict[tuple[Kind, str], list[Place]],
    findings: list[Finding],
) -> None:
    read = metadata.read(document)
    places = _places(file, read)
    queries = list(read.queries())
    results = await rules.names(document, queries)
    node = results[0] if isinstance(results[0], str) else None
    for place, result in zip(places, results, strict=True):
        if isinstance(result, RossecError):
            label = _LABELS.get(type(result), "rules")
            findings.append(Finding(file, place.line, label, f"{place.label}: {result}"))
            continue
        names[place.kind, result].append(place)
        if covered is not None and node is not None and not covered(node, place.kind, result):
            message = f"{place.label}: no grant or rule covers {result} for {node}"
            findings.append(Finding(file, place.line, "uncovered", message))
    findings += await _order_dependent(rules, document, places, results)


def _places(file: str, read: Metadata) -> list[Place]:
    """In the order of `read.queries()`."""
    entries = [Place(file, entry.line, entry.kind, entry.name) for entry in read.entries]
    return [Place(file, 1, Kind.NODE, ""), *entries]


async def _order_dependent(
    rules: RuleRunner, document: bytes, places: list[Place], results: list[Result]
) -> list[Finding]:
    """Of each name at most one finding, with another order's name beside it."""
    found: dict[Place, Finding] = {}
    queries = [(place.kind, place.which) for place in places]
    for other in orders(document):
        for place, first, second in zip(
            places, results, await rules.names(other, queries), strict=True
        ):
            if _text(first) != _text(second) and place not in found:
                found[place] = Finding(
                    place.file, place.line, "order",
                    f"{place.label}: {_text(first)}, but in another order of the same metadata"
                    f" {_text(second)}",
                )  # fmt: skip
    return list(found.values())


def _text(result: Result) -> str:
    return result if isinstance(result, str) else f"no name ({result})"


def _collisions(names: dict[tuple[Kind, str], list[Place]]) -> Iterable[Finding]:
    for (_, name), places in names.items():
        for place in places[1:]:
            first = places[0]
            message = f"{place.label}: {name} is also {first.label} in {first.file}:{first.line}"
            yield Finding(place.file, place.line, "collision", message)
