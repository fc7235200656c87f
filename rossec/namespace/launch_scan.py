"""Where the metadata of nodes stand in a launch file: positions in its bytes. Pure.

Metadata are elements in `urn:schemas-tum-de:vmi:ns` inside a `<node>`. Everything else is only
passed over, so that an edit by these positions leaves it as it is. What the rules are to see of a
node is written anew (`LaunchNode.metadata`): without the namespace, and with the node's name.
A substitution of roslaunch, `$(...)`, has no value yet: it is refused where a name comes of it.
"""

import re
from dataclasses import dataclass, field
from typing import Final, NamedTuple, NoReturn
from xml.parsers import expat
from xml.sax.saxutils import escape

from rossec.errors import MetadataRefused
from rossec.naming.documents import check_document
from rossec.naming.metadata import Kind

NAMESPACE: Final = "urn:schemas-tum-de:vmi:ns"
WHAT: Final = "a launch file"
MAX_DEPTH: Final = 32
_ROOT: Final = "launch"
_SEPARATOR: Final = " "
_FROM: Final = re.compile(r"[~/]?[A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)*")
_TAG: Final = re.compile(rb"<[^\s/>]+")
_ATTRIBUTE: Final = re.compile(rb"""\s+([^\s=<>/"']+)\s*=\s*("[^"]*"|'[^']*')""")
_TAG_END: Final = re.compile(rb"\s*(/?)>")
_ENTRIES: Final = frozenset({Kind.TOPIC.value, Kind.SERVICE.value})
_SUBSTITUTION: Final = "$("


class Span(NamedTuple):
    """Bytes `start` to `end` of the file."""

    start: int
    end: int


@dataclass
class Tag:
    """A start tag: where it is, and where each attribute's value is (inside the quotes)."""

    span: Span
    empty: bool
    values: dict[str, Span]

    @property
    def insertion(self) -> int:
        """Where another attribute can be written: before `>` or `/>`."""
        return self.span.end - (2 if self.empty else 1)


@dataclass
class Element:
    """An element of metadata; `whole` covers it from `<` to `>`."""

    name: str
    line: int
    attributes: dict[str, str]
    whole: Span
    text: str = ""
    children: list["Element"] = field(default_factory=list)

    def write(self) -> str:
        """The element without namespace and attributes."""
        inner = "".join(child.write() for child in self.children)
        return f"<{self.name}>{escape(self.text.strip())}{inner}</{self.name}>"

    def child(self, name: str) -> str | None:
        """The text of the first child `name`."""
        return next((found.text.strip() for found in self.children if found.name == name), None)


@dataclass
class LaunchNode:
    """A `<node>` with metadata: its name in the file, its tag, its elements of metadata."""

    name: str
    line: int
    tag: Tag
    elements: list[Element] = field(default_factory=list)
    remaps: set[str] = field(default_factory=set)

    def entries(self) -> list[tuple[Element, Kind, str, str]]:
        """Its topics and services: element, kind, name in the metadata, name in the program.

        Raises:
            MetadataRefused: one without a name, or that does not say which name it replaces.
        """
        return [_entry(found, self) for found in self.elements if found.name in _ENTRIES]

    def metadata(self) -> bytes:
        """The metadata as rules take them, UTF-8."""
        inner = "".join(element.write() for element in self.elements)
        return f"<node><name>{escape(self.name)}</name>{inner}</node>".encode()


@dataclass
class Include:
    """An `<include>`: what it names, and where that stands."""

    file: str
    line: int
    value: Span


@dataclass
class Launch:
    """What was found in a launch file."""

    nodes: list[LaunchNode]
    includes: list[Include]


def scan(data: bytes) -> Launch:
    """Find the nodes with metadata, and the includes.

    Raises:
        MetadataRefused: malformed, too long, or metadata that make no sense; it names the line.
    """
    check_document(data, WHAT)
    reader = _Reader(data)
    try:
        reader.parse()
    except expat.ExpatError as error:
        message = expat.ErrorString(error.code)
        raise MetadataRefused(f"line {error.lineno}: {WHAT} that is no XML: {message}") from None
    except (ValueError, LookupError) as error:
        raise MetadataRefused(f"{WHAT} that cannot be read: {error}") from None
    nodes = [node for node in reader.nodes if node.elements]
    for node in nodes:
        _check(node)
    return Launch(nodes, reader.includes)


def refuse(line: int, message: str, hint: str = "") -> NoReturn:
    """Raise for something on a line of the file."""
    raise MetadataRefused(f"line {line}: {message}", hint)


class _Reader:
    """The handlers of the parser."""

    def __init__(self, data: bytes) -> None:
        self.nodes: list[LaunchNode] = []
        self.includes: list[Include] = []
        self._data = data
        self._open: list[LaunchNode | Element | None] = []
        self._starts: list[Tag] = []
        self._parser = parser = expat.ParserCreate(namespace_separator=_SEPARATOR)
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text
        parser.StartDoctypeDeclHandler = self._declared  # refused by its characters already
        parser.buffer_text = True

    def parse(self) -> None:
        self._parser.Parse(self._data, True)

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        tag, line = self._tag(), self._parser.CurrentLineNumber
        if len(self._open) >= MAX_DEPTH:
            refuse(line, f"elements nested deeper than {MAX_DEPTH}")
        namespace, _, local = name.rpartition(_SEPARATOR)
        if not self._open and local != _ROOT:
            refuse(line, f"{WHAT} is a <{_ROOT}>, not <{local}>")
        made: LaunchNode | Element | None = None
        parent = self._open[-1] if self._open else None
        if namespace == NAMESPACE:
            made = Element(local, line, dict(attributes), tag.span)
            if parent is None:
                refuse(line, f"<{local}> of the metadata is not inside a <node>")
            (parent.elements if isinstance(parent, LaunchNode) else parent.children).append(made)
        elif isinstance(parent, Element):
            refuse(line, f"<{local}> is inside metadata", "close the metadata before it")
        else:
            made = self._plain(local, line, tag, attributes, parent)
        self._open.append(made)
        self._starts.append(tag)

    def _plain(
        self,
        local: str,
        line: int,
        tag: Tag,
        attributes: dict[str, str],
        parent: LaunchNode | None,
    ) -> LaunchNode | None:
        """An element of roslaunch."""
        if local == "node":
            node = LaunchNode(attributes.get("name", ""), line, tag)
            self.nodes.append(node)
            return node
        if local == "remap" and parent is not None:
            parent.remaps.add(attributes.get("from", ""))
        if local == "include" and "file" in tag.values:
            self.includes.append(Include(attributes["file"], line, tag.values["file"]))
        return None

    def _end(self, _: str) -> None:
        made, tag = self._open.pop(), self._starts.pop()
        if isinstance(made, Element):
            at = self._parser.CurrentByteIndex
            end = tag.span.end if tag.empty else self._data.index(b">", at) + 1
            made.whole = Span(tag.span.start, end)

    def _text(self, text: str) -> None:
        parent = self._open[-1] if self._open else None
        if isinstance(parent, Element):
            parent.text += text

    def _declared(self, *_: object) -> NoReturn:
        raise MetadataRefused(f"{WHAT} with a document type")

    def _tag(self) -> Tag:
        """The start tag at which the parser is: well-formed, as the parser has read it."""
        start, values = self._parser.CurrentByteIndex, dict[str, Span]()
        found = _TAG.match(self._data, start)
        at = start if found is None else found.end()
        while (found := _ATTRIBUTE.match(self._data, at)) is not None:
            values[found[1].decode("utf-8", "replace")] = Span(found.start(2) + 1, found.end(2) - 1)
            at = found.end()
        end = _TAG_END.match(self._data, at)
        if end is None:
            refuse(self._parser.CurrentLineNumber, f"a tag of {WHAT} that cannot be read")
        return Tag(Span(start, end.end()), end[1] == b"/", values)


def _check(node: LaunchNode) -> None:
    """Refuse what has no meaning, or another one than it seems to have."""
    if "ns" in node.tag.values:
        refuse(node.line, f"the node {node.name!a} has metadata and ns=", "leave one of them out")
    if not node.name or _SUBSTITUTION in node.name:
        refuse(
            node.line, "a node with metadata whose name is not written out",
            "roslaunch replaces $(...) later than this: write the name",
        )  # fmt: skip
    for element in node.elements:
        if element.name == "name":
            refuse(element.line, "the name of a node is that of <node name=...>", "leave it out")
        _check_element(element)


def _check_element(element: Element) -> None:
    allowed = {"type"} if element.name in _ENTRIES else set()
    if set(element.attributes) - allowed:
        refuse(element.line, f"<{element.name}> of the metadata has an attribute it may not have")
    if _SUBSTITUTION in element.text:
        refuse(
            element.line, f"<{element.name}> has $(...)",
            "roslaunch replaces it later than this: write the value",
        )  # fmt: skip
    if element.children and element.text.strip():
        refuse(element.line, f"<{element.name}> of the metadata has text beside elements")
    for child in element.children:
        _check_element(child)


def _entry(element: Element, node: LaunchNode) -> tuple[Element, Kind, str, str]:
    name, source = element.child("name"), element.attributes.get("type", "")
    if not name:
        refuse(element.line, f"a {element.name} of {node.name!a} without <name>")
    if _FROM.fullmatch(source) is None:
        refuse(
            element.line, f"a {element.name} of {node.name!a} without the name that it replaces",
            f'write which name the program uses: <{element.name} type="~output">',
        )  # fmt: skip
    if source in node.remaps:
        refuse(element.line, f"{source} of {node.name!a} is remapped already", "leave one out")
    return element, Kind(element.name), name, source
