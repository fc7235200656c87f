"""The metadata of a node: who owns it, what it is, which topics and services it has.

The elements are the thesis's (section 4.4, appendix A). Others may stand beside them: rules may
use whatever they like, and only what names have to be found for is read here. Metadata are claims
of a node: nothing is granted by them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import ParseError
from xml.parsers import expat

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from rossec.errors import MetadataRefused
from rossec.naming.documents import check_document

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

MAX_ENTRIES: Final = 256
MAX_WHICH: Final = 255
_ENTRIES: Final = frozenset({"topic", "service"})
_MOBILE: Final = {"true": True, "false": False, None: None}
_HINT: Final = "for example <node><name>lamp</name><topic><name>state</name></topic></node>"


class Kind(StrEnum):
    """What a name is asked for; the rules see it as `$type`."""

    NODE = "node"
    TOPIC = "topic"
    SERVICE = "service"


@dataclass(frozen=True)
class Entry:
    """One topic or service, on a line of its document. What is not said is None."""

    kind: Kind
    name: str
    function: str | None = None
    location: str | None = None
    mobile: bool | None = None
    line: int = field(default=1, compare=False)


@dataclass(frozen=True)
class Metadata:
    """One node, with its topics and services in the order of the document."""

    owner: str | None = None
    name: str | None = None
    group: str | None = None
    entries: tuple[Entry, ...] = ()

    def queries(self) -> Iterator[tuple[Kind, str]]:
        """Everything that a name can be asked for: the node, then its topics and services."""
        yield Kind.NODE, ""
        for entry in self.entries:
            yield entry.kind, entry.name


def read(data: bytes) -> Metadata:
    """Read metadata.

    Raises:
        MetadataRefused: malformed, too long, not a `<node>`, or something in it is said twice.
    """
    root = parse(data)
    if root.tag != "node":
        raise MetadataRefused(f"metadata are a <node>, not <{root.tag[:60]}>", _HINT)
    found = [each for each in root if each.tag in _ENTRIES]
    if len(found) > MAX_ENTRIES:
        raise MetadataRefused(f"{len(found)} topics and services where {MAX_ENTRIES} are allowed")
    entries = tuple(map(_entry, found, _lines(data)))
    known = [(entry.kind, entry.name) for entry in entries]
    for kind, name in known:
        if known.count((kind, name)) > 1:
            raise MetadataRefused(f"two {kind}s with the name {name!a}", "give each its own name")
    return Metadata(_text(root, "owner"), _text(root, "name"), _text(root, "group"), entries)


def parse(data: bytes, what: str = "metadata") -> "Element":
    """The root element of a checked document.

    Raises:
        MetadataRefused: malformed or too long.
    """
    check_document(data, what)
    try:
        root: Element = ElementTree.fromstring(data, forbid_dtd=True)
    except ParseError as error:
        line, _ = error.position
        raise MetadataRefused(f"line {line}: {what} that are no XML: {error}", _HINT) from None
    except (DefusedXmlException, ValueError, LookupError) as error:
        raise MetadataRefused(f"{what} that cannot be read: {error}", _HINT) from None
    return root


def check_query(kind: Kind, which: str) -> tuple[Kind, str]:
    """Return what a name is asked for: a node has no `which`, a topic or service one of a line.

    Raises:
        MetadataRefused: anything else.
    """
    if (kind is Kind.NODE) is not (which == ""):
        raise MetadataRefused(
            "a topic or service is asked for by its name in the metadata", "a node has none"
        )
    if len(which) > MAX_WHICH or not which.isprintable():
        raise MetadataRefused(f"{which[:60]!a} is no name of a {kind} in metadata")
    return kind, which


def _lines(data: bytes) -> list[int]:
    """The lines on which topics and services begin, of a document that was parsed before."""
    parser, found, depth = expat.ParserCreate(), list[int](), 0

    def start(tag: str, _: object) -> None:
        nonlocal depth
        depth += 1
        if depth == 2 and tag in _ENTRIES:
            found.append(parser.CurrentLineNumber)

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return found


def _entry(element: "Element", line: int) -> Entry:
    name = _text(element, "name")
    if name is None:
        raise MetadataRefused(f"line {line}: a {element.tag} without <name>", _HINT)
    check_query(Kind(element.tag), name)
    mobile = _text(element, "mobile")
    if mobile not in _MOBILE:
        raise MetadataRefused(f"line {line}: <mobile> is true or false, not {mobile!a:.60}")
    return Entry(
        Kind(element.tag), name, _text(element, "function"), _text(element, "location"),
        _MOBILE[mobile], line,
    )  # fmt: skip


def _text(element: "Element", tag: str) -> str | None:
    """The text of the one child `tag`, without space around it; None: missing or empty."""
    found = element.findall(tag)
    if len(found) > 1:
        raise MetadataRefused(f"<{element.tag}> has {len(found)} times <{tag}>", "once is enough")
    if not found:
        return None
    if len(found[0]):
        raise MetadataRefused(f"<{tag}> has other elements inside", "it is a text")
    return (found[0].text or "").strip() or None
