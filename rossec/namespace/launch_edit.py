"""A launch file with the names that rules gave, in place of metadata. Pure: bytes to bytes.

Edits are made at positions of the source, never by writing the document anew: comments, spaces,
order and encoding of everything else remain. A node gets `ns=`, and another `name=` if the rules
gave one; a topic or service becomes a `<remap>`; a line that had nothing but metadata is left out.
"""

import re
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple
from xml.sax.saxutils import quoteattr

from rossec.errors import RossecError
from rossec.namespace.launch_scan import Launch, LaunchNode, Span, refuse
from rossec.naming.metadata import Kind

Query = tuple[Kind, str]
NameOf = Callable[[bytes, Sequence[Query]], Sequence[str]]
"""The names for the queries by some metadata, in order; raises a `RossecError` if there is none."""

_BEFORE: Final = re.compile(rb"[ \t]*\Z")
_AFTER: Final = re.compile(rb"[ \t]*(?:\r?\n|\Z)")
_BETWEEN: Final = re.compile(rb"[ \t]*")


class Edit(NamedTuple):
    """The bytes of `span` become `text`."""

    span: Span
    text: bytes


class NamedEntry(NamedTuple):
    """A topic or service of a node: its name in the program, and the one it gets."""

    kind: Kind
    source: str
    name: str


class NamedNode(NamedTuple):
    """A node of the file with the names that it gets."""

    line: int
    name: str
    entries: tuple[NamedEntry, ...]


def named(launch: Launch, name_of: NameOf) -> list[NamedNode]:
    """The names for the nodes of a file, in its order.

    Raises:
        RossecError: there is none, or two nodes get the same; the message names the line.
    """
    found = [_named(node, name_of) for node in launch.nodes]
    lines: dict[str, int] = {}
    for node in found:
        if node.name in lines:
            refuse(
                node.line, f"the rules name two nodes {node.name}: this one and line "
                f"{lines[node.name]}", "give them different names or owners",
            )  # fmt: skip
        lines[node.name] = node.line
    return found


def edits(data: bytes, launch: Launch, nodes: Sequence[NamedNode]) -> list[Edit]:
    """What becomes of the metadata in the file."""
    made: list[Edit] = []
    for node, given in zip(launch.nodes, nodes, strict=True):
        made += _of_tag(node, given.name)
        remaps = {
            id(entry[0]): new for entry, new in zip(node.entries(), given.entries, strict=True)
        }
        gone: list[Span] = []
        for element in node.elements:
            new = remaps.get(id(element))
            if new is None:
                gone.append(element.whole)
            else:
                made.append(Edit(element.whole, _remap(new)))
        made += [Edit(_lines(data, span), b"") for span in _joined(data, gone)]
    return made


def apply(data: bytes, changes: Sequence[Edit]) -> bytes:
    """The bytes after `changes`, which do not overlap."""
    parts: list[bytes] = []
    at = 0
    for span, text in sorted(changes):
        parts += [data[at : span.start], text]
        at = span.end
    return b"".join([*parts, data[at:]])


def _named(node: LaunchNode, name_of: NameOf) -> NamedNode:
    entries = node.entries()
    sources = [source for *_, source in entries]
    for element, _, _, source in entries:
        if sources.count(source) > 1:
            refuse(element.line, f"{source} of {node.name!a} would get two names")
    queries: list[Query] = [(Kind.NODE, ""), *((kind, which) for _, kind, which, _ in entries)]
    try:
        own, *others = name_of(node.metadata(), queries)
    except RossecError as error:
        text = f"line {node.line}: the node {node.name!a}: {error}"
        raise type(error)(text, error.hint) from error
    return NamedNode(
        node.line,
        own,
        tuple(
            NamedEntry(kind, source, name)
            for (_, kind, _, source), name in zip(entries, others, strict=True)
        ),
    )


def _of_tag(node: LaunchNode, name: str) -> list[Edit]:
    """The start tag of a node that is to be called `name`."""
    above, _, last = name.rpartition("/")
    at = node.tag.insertion
    made = [Edit(Span(at, at), b" ns=" + _quoted(above or "/"))]
    if last != node.name:
        made.append(Edit(node.tag.values["name"], last.encode("ascii")))
    return made


def _remap(entry: NamedEntry) -> bytes:
    return b"<remap from=" + _quoted(entry.source) + b" to=" + _quoted(entry.name) + b"/>"


def _quoted(text: str) -> bytes:
    return quoteattr(text).encode("ascii")


def _joined(data: bytes, spans: Sequence[Span]) -> list[Span]:
    """Spans with nothing but space between them on a line count as one."""
    made: list[Span] = []
    for span in spans:
        if made and _BETWEEN.fullmatch(data, made[-1].end, span.start):
            made[-1] = Span(made[-1].start, span.end)
        else:
            made.append(span)
    return made


def _lines(data: bytes, span: Span) -> Span:
    """The whole lines of `span` if they have nothing else, else `span`."""
    start = data.rfind(b"\n", 0, span.start) + 1
    after = _AFTER.match(data, span.end)
    if after is None or _BEFORE.fullmatch(data, start, span.start) is None:
        return span
    return Span(start, after.end())
