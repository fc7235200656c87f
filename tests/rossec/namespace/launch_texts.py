"""Launch files for tests, and rules that are one line of Python."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from rossec.namespace.launch_file import NamedNode, NameOf, apply, edits, named, scan
from rossec.naming.requests import NameKind

FIGURES: Final = Path(__file__).parent / "launch"
NS: Final = 'xmlns:ns="urn:schemas-tum-de:vmi:ns"'


def launch(*inside: str) -> bytes:
    """A launch file."""
    return f"<launch {NS}>\n{''.join(inside)}</launch>\n".encode()


def node(*metadata: str, name: str = "lamp", more: str = "") -> str:
    """A `<node>` on lines of its own."""
    inside = "".join(f"    {line}\n" for line in metadata)
    return f'  <node name="{name}" pkg="p" type="t"{more}>\n{inside}  </node>\n'


def topic(name: str = "state", source: str = "~state", *more: str) -> str:
    """Metadata of a topic, on one line."""
    inside = "".join((f"<ns:name>{name}</ns:name>", *more))
    return f'<ns:topic type="{source}">{inside}</ns:topic>'


def transform(data: bytes, name_of: NameOf) -> tuple[bytes, list[NamedNode]]:
    """The file with names in place of metadata, and its nodes."""
    found = scan(data)
    nodes = named(found, name_of)
    return apply(data, edits(data, found, nodes)), nodes


def simple(metadata: bytes, queries: Sequence[tuple[NameKind, str]]) -> list[str]:
    """`/GROUP/NAME` and `/GROUP/NAME/ENTRY`."""
    root = ElementTree.fromstring(metadata)
    own = f"/{root.findtext('group') or 'nowhere'}/{root.findtext('name')}"
    return [own if kind is NameKind.NODE else f"{own}/{which}" for kind, which in queries]
