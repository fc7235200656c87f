"""A launch file with the names that rules gave, in place of metadata. Pure: bytes to bytes.

Metadata are elements in `urn:schemas-tum-de:vmi:ns` inside a `<node>`.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, NoReturn
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from rossec.errors import MetadataRefused, RossecError
from rossec.naming import NameKind, check_document

NAMESPACE: Final = "urn:schemas-tum-de:vmi:ns"
WHAT: Final = "a launch file"
MAX_DEPTH: Final = 32
_ROOT: Final = "launch"
_SEPARATOR: Final = " "
_FROM: Final = re.compile(r"[~/]?[A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)*")
_TAG: Final = re.compile(rb"<[^\s/>]+")
_ATTRIBUTE: Final = re.compile(rb"""\s+([^\s=<>/"']+)\s*=\s*("[^"]*"|'[^']*')""")
_TAG_END: Final = re.compile(rb"\s*(/?)>")
_ENTRIES: Final = frozenset({NameKind.TOPIC.value, NameKind.SERVICE.value})
_SUBSTITUTION: Final = "$("
Query = tuple[NameKind, str]
NameOf = Callable[[bytes, Sequence[Query]], Sequence[str]]
"""The names for the queries by some metadata, in order; raises a `RossecError` if there is none."""
_BEFORE: Final = re.compile(rb"[ \t]*\Z")
_AFTER: Final = re.compile(rb"[ \t]*(?:\r?\n|\Z)")
_BETWEEN: Final = re.compile(rb"[ \t]*")


class ByteSpan(NamedTuple):
    start: int
    end: int


@dataclass
class Tag:
    span: ByteSpan
    empty: bool
    values: dict[str, ByteSpan]

    @property
    def insertion(self) -> int:
        return self.span.end - (2 if self.empty else 1)


@dataclass
class LaunchElement:
    name: str
    line: int
    attributes: dict[str, str]
    whole: ByteSpan
    text: str = ""
    children: list["LaunchElement"] = field(default_factory=list)

    def write(self) -> str:
        inner = "".join(child.write() for child in self.children)
        return f"<{self.name}>{escape(self.text.strip())}{inner}</{self.name}>"

    def child(self, name: str) -> str | None:
        return next((found.text.strip() for found in self.children if found.name == name), None)


@dataclass
class LaunchNode:
    name: str
    line: int
    tag: Tag
    elements: list[LaunchElement] = field(default_factory=list)
    remaps: set[str] = field(default_factory=set)

    def entries(self) -> list[tuple[LaunchElement, NameKind, str, str]]:
        return [_entry(found, self) for found in self.elements if found.name in _ENTRIES]

    def metadata(self) -> bytes:
        # What the rules are to see: written anew, without the namespace, and with the node's name.
        inner = "".join(element.write() for element in self.elements)
        return f"<node><name>{escape(self.name)}</name>{inner}</node>".encode()


@dataclass
class Include:
    file: str
    line: int
    value: ByteSpan


@dataclass
class Launch:
    nodes: list[LaunchNode]
    includes: list[Include]


def scan(data: bytes) -> Launch:
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


class _Reader:
    def __init__(self, data: bytes) -> None:
        self.nodes: list[LaunchNode] = []
        self.includes: list[Include] = []
        self._data = data
        self._open: list[LaunchNode | LaunchElement | None] = []
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
        made: LaunchNode | LaunchElement | None = None
        parent = self._open[-1] if self._open else None
        if namespace == NAMESPACE:
            made = LaunchElement(local, line, dict(attributes), tag.span)
            if parent is None:
                refuse(line, f"<{local}> of the metadata is not inside a <node>")
            (parent.elements if isinstance(parent, LaunchNode) else parent.children).append(made)
        elif isinstance(parent, LaunchElement):
            refuse(line, f"<{local}> is inside metadata", "close the metadata before it")
        else:
            made = self._plain(local, line, tag, attributes, parent)
        self._open.append(made)
        self._starts.append(tag)

    def _plain(
        self, local: str, line: int, tag: Tag, attributes: dict[str, str], parent: LaunchNode | None
    ) -> LaunchNode | None:
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
        if isinstance(made, LaunchElement):
            at = self._parser.CurrentByteIndex
            end = tag.span.end if tag.empty else self._data.index(b">", at) + 1
            made.whole = ByteSpan(tag.span.start, end)

    def _text(self, text: str) -> None:
        parent = self._open[-1] if self._open else None
        if isinstance(parent, LaunchElement):
            parent.text += text

    def _declared(self, *_: object) -> NoReturn:
        raise MetadataRefused(f"{WHAT} with a document type")

    def _tag(self) -> Tag:
        start, values = self._parser.CurrentByteIndex, dict[str, ByteSpan]()
        found = _TAG.match(self._data, start)
        at = start if found is None else found.end()
        while (found := _ATTRIBUTE.match(self._data, at)) is not None:
            values[found[1].decode("utf-8", "replace")] = ByteSpan(found.start(2) + 1, found.end(2) - 1)
            at = found.end()
        end = _TAG_END.match(self._data, at)
        if end is None:
            refuse(self._parser.CurrentLineNumber, f"a tag of {WHAT} that cannot be read")
        return Tag(ByteSpan(start, end.end()), end[1] == b"/", values)


def refuse(line: int, message: str, hint: str = "") -> NoReturn:
    raise MetadataRefused(f"line {line}: {message}", hint)


def _check(node: LaunchNode) -> None:
    if "ns" in node.tag.values:
        refuse(node.line, f"the node {node.name!a} has metadata and ns=", "leave one of them out")
    # A substitution of roslaunch has no value yet: it is refused where a name comes of it.
    if not node.name or _SUBSTITUTION in node.name:
        hint = "roslaunch replaces $(...) later than this: write the name"
        refuse(node.line, "a node with metadata whose name is not written out", hint)
    for element in node.elements:
        if element.name == "name":
            refuse(element.line, "the name of a node is that of <node name=...>", "leave it out")
        _check_element(element)


def _check_element(element: LaunchElement) -> None:
    allowed = {"type"} if element.name in _ENTRIES else set()
    if set(element.attributes) - allowed:
        refuse(element.line, f"<{element.name}> of the metadata has an attribute it may not have")
    if _SUBSTITUTION in element.text:
        hint = "roslaunch replaces it later than this: write the value"
        refuse(element.line, f"<{element.name}> has $(...)", hint)
    if element.children and element.text.strip():
        refuse(element.line, f"<{element.name}> of the metadata has text beside elements")
    for child in element.children:
        _check_element(child)


class NamedEntry(NamedTuple):
    kind: NameKind
    source: str
    name: str


class NamedNode(NamedTuple):
    line: int
    name: str
    entries: tuple[NamedEntry, ...]


def named(launch: Launch, name_of: NameOf) -> list[NamedNode]:
    found = [_named(node, name_of) for node in launch.nodes]
    lines: dict[str, int] = {}
    for node in found:
        if node.name in lines:
            said = f"the rules name two nodes {node.name}: this one and line {lines[node.name]}"
            refuse(node.line, said, "give them different names or owners")
        lines[node.name] = node.line
    return found


def _named(node: LaunchNode, name_of: NameOf) -> NamedNode:
    entries = node.entries()
    sources = [source for *_, source in entries]
    for element, _, _, source in entries:
        if sources.count(source) > 1:
            refuse(element.line, f"{source} of {node.name!a} would get two names")
    queries: list[Query] = [(NameKind.NODE, ""), *((kind, which) for _, kind, which, _ in entries)]
    try:
        own, *others = name_of(node.metadata(), queries)
    except RossecError as error:
        text = f"line {node.line}: the node {node.name!a}: {error}"
        raise type(error)(text, error.hint) from error
    pairs = zip(entries, others, strict=True)
    return NamedNode(node.line, own, tuple(NamedEntry(kind, of, name) for (_, kind, _, of), name in pairs))


class Edit(NamedTuple):
    span: ByteSpan
    text: bytes


def edits(data: bytes, launch: Launch, nodes: Sequence[NamedNode]) -> list[Edit]:
    made: list[Edit] = []
    for node, given in zip(launch.nodes, nodes, strict=True):
        # A node gets `ns=`, and another `name=` if the rules gave one; a topic or service a `<remap>`.
        above, _, last = given.name.rpartition("/")
        at = node.tag.insertion
        made.append(Edit(ByteSpan(at, at), b" ns=" + _quoted(above or "/")))
        if last != node.name:
            made.append(Edit(node.tag.values["name"], last.encode("ascii")))
        remaps = {id(entry[0]): new for entry, new in zip(node.entries(), given.entries, strict=True)}
        gone: list[ByteSpan] = []
        for element in node.elements:
            new = remaps.get(id(element))
            if new is None:
                gone.append(element.whole)
            else:
                remap = b"<remap from=" + _quoted(new.source) + b" to=" + _quoted(new.name) + b"/>"
                made.append(Edit(element.whole, remap))
        made += [Edit(_lines(data, span), b"") for span in _joined(data, gone)]
    return made


def _quoted(text: str) -> bytes:
    return quoteattr(text).encode("ascii")


def _lines(data: bytes, span: ByteSpan) -> ByteSpan:
    # A line that has nothing but metadata is left out.
    start = data.rfind(b"\n", 0, span.start) + 1
    after = _AFTER.match(data, span.end)
    if after is None or _BEFORE.fullmatch(data, start, span.start) is None:
        return span
    return ByteSpan(start, after.end())


def _joined(data: bytes, spans: Sequence[ByteSpan]) -> list[ByteSpan]:
    made: list[ByteSpan] = []
    for span in spans:
        if made and _BETWEEN.fullmatch(data, made[-1].end, span.start):
            made[-1] = ByteSpan(made[-1].start, span.end)
        else:
            made.append(span)
    return made


# At positions of the source, never by writing the document anew: comments, spaces, order and encoding of
# everything else remain.
def apply(data: bytes, changes: Sequence[Edit]) -> bytes:
    parts: list[bytes] = []
    at = 0
    for span, text in sorted(changes):
        parts += [data[at : span.start], text]
        at = span.end
    return b"".join([*parts, data[at:]])


def _entry(element: LaunchElement, node: LaunchNode) -> tuple[LaunchElement, NameKind, str, str]:
    name, source = element.child("name"), element.attributes.get("type", "")
    if not name:
        refuse(element.line, f"a {element.name} of {node.name!a} without <name>")
    if _FROM.fullmatch(source) is None:
        said = f"a {element.name} of {node.name!a} without the name that it replaces"
        refuse(element.line, said, f'write which name the program uses: <{element.name} type="~output">')
    if source in node.remaps:
        refuse(element.line, f"{source} of {node.name!a} is remapped already", "leave one out")
    return element, NameKind(element.name), name, source
