"""Metadata of nodes, and what goes between a process that applies rules and the one that asks it. Pure.

Metadata are claims of a node: nothing is granted by them.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR: `[rules, metadata,
[[kind, which], ...], thesis_defaults]` one way; without metadata the rules are compiled only. The other way
`[0, [result, ...]]` with `[0, text]` or `[code, message, hint]` for each query, or `[code, message, hint]`.
An answer is not trusted: a process that was taken over may have written it. So names are checked.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import ParseError
from xml.parsers import expat

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, NameRefused
from ca.names import check_name
from rossec import errors

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


MAX_INPUT: Final = 256 * 1024
MAX_ENTRIES: Final = 256
MAX_WHICH: Final = 255
HEAD: Final = 4
MAX_REQUEST: Final = 2 * MAX_INPUT + (MAX_ENTRIES + 1) * (4 * MAX_WHICH + 16) + 64
MAX_ANSWER: Final = 1024 * 1024
MAX_TEXT: Final = 1024  # characters of a name; legal ones have 255
READY: Final = b"\x00"  # the body of the first frame of a process, once it is confined
# What lies below these is not for rules: identities that nodes trust, those of the own services, names of
# other domains (`/remote`), and topics that every node may use without a grant.
RESERVED: Final = frozenset(
    """remote master ca relay gateway router console border namespace sidecar rosout rosout_agg clock
    rossec""".split()  # noqa: SIM905 - read as a text
)
THESIS_DEFAULTS: Final = ("unknown-group", "unknown-node", "unknown-location")
# Only encodings in which ASCII is ASCII: others could hide a document type.
_ENCODINGS: Final = frozenset({"utf-8", "iso-8859-1", "us-ascii", "ascii"})
_DECLARED: Final = re.compile(rb"""<\?xml\s[^>]*?encoding\s*=\s*["']([^"'>]*)["'][^>]*\?>""")
_DECLARATION: Final = re.compile(rb"<!(?:DOCTYPE|ENTITY|ELEMENT|ATTLIST|NOTATION)", re.IGNORECASE)
_BOM: Final = b"\xef\xbb\xbf"
_SPACE: Final = b" \t\r\n"
_ENTRIES: Final = frozenset({"topic", "service"})
_MOBILE: Final = {"true": True, "false": False, None: None}
_ERRORS: Final = (
    errors.RulesRefused,
    errors.MetadataRefused,
    errors.NameUndefined,
    errors.RulesExceeded,
    errors.RulesNotConfined,
)
_HINT: Final = "for example <node><name>lamp</name><topic><name>state</name></topic></node>"
_ODD: Final = "the process that applies rules answers in another form"


class NameKind(StrEnum):
    """What a name is asked for; the rules see it as `$type`."""

    NODE = "node"
    TOPIC = "topic"
    SERVICE = "service"


@dataclass(frozen=True)
class Entry:
    """A topic or service. What is not said is None."""

    kind: NameKind
    name: str
    function: str | None = None
    location: str | None = None
    mobile: bool | None = None
    line: int = field(default=1, compare=False)


@dataclass(frozen=True)
class Metadata:
    """The elements of the thesis (section 4.4, appendix A) for which names have to be found.

    Others may stand beside them: rules may use whatever they like.
    """

    owner: str | None = None
    name: str | None = None
    group: str | None = None
    entries: tuple[Entry, ...] = ()

    def queries(self) -> Iterator[tuple[NameKind, str]]:
        yield NameKind.NODE, ""
        for entry in self.entries:
            yield entry.kind, entry.name


@dataclass(frozen=True)
class NameRequest:
    rules: bytes
    metadata: bytes
    queries: tuple[tuple[NameKind, str], ...] = ()
    thesis_defaults: bool = False


Result = str | errors.RossecError


def check_rules(data: bytes) -> bytes:
    """Return `data` if it may be parsed as rules; else raise `RulesRefused`."""
    return check_document(data, "rules", errors.RulesRefused)


def check_document(
    data: bytes, what: str = "metadata", refusal: type[errors.RossecError] = errors.MetadataRefused
) -> bytes:
    """Return `data` if it may be parsed as `what`: metadata, rules, or a launch file."""
    # By its characters, before any parser sees it: those are written in C, and it comes from people and
    # nodes.
    if len(data) > MAX_INPUT:
        raise refusal(
            f"{len(data)} bytes of {what} where at most {MAX_INPUT} are allowed",
            "metadata of one node are some lines; rules are a few hundred at most",
        )
    if not data.strip():
        raise refusal(f"empty {what}", "an XML document is needed")
    # Entities are declared in a document type (billion laughs, XXE).
    found = _DECLARATION.search(data)
    if found is not None:
        line = data.count(b"\n", 0, found.start()) + 1
        raise refusal(f"line {line}: {what} with a document type or entities", "leave <!DOCTYPE ...> out")
    encoding = _encoding(data)
    if encoding not in _ENCODINGS or b"\0" in data:
        raise refusal(f"{what} in the encoding {encoding[:40]!a}", "use UTF-8 or ISO-8859-1")
    # Parsers guess other encodings by the first bytes (EBCDIC).
    if not data.removeprefix(_BOM).lstrip(_SPACE).startswith(b"<"):
        raise refusal(f"line 1: {what} that begin with no element", "an XML document is needed")
    return data


def _encoding(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    text = data.removeprefix(_BOM)
    if not text.startswith(b"<?xml"):
        return "utf-8"
    end = text.find(b"?>")
    if end < 0:
        return "unknown"
    head = text[: end + 2]
    if b"encoding" not in head:
        return "utf-8"
    found = _DECLARED.fullmatch(head) if head.count(b"encoding") == 1 else None
    return "unknown" if found is None else found[1].decode("ascii", "replace").lower()


def read(data: bytes) -> Metadata:
    root = parse(data)
    if root.tag != "node":
        raise errors.MetadataRefused(f"metadata are a <node>, not <{root.tag[:60]}>", _HINT)
    found = [each for each in root if each.tag in _ENTRIES]
    if len(found) > MAX_ENTRIES:
        raise errors.MetadataRefused(f"{len(found)} topics and services where {MAX_ENTRIES} are allowed")
    entries = tuple(map(_entry, found, _lines(data)))
    known = [(entry.kind, entry.name) for entry in entries]
    for kind, name in known:
        if known.count((kind, name)) > 1:
            raise errors.MetadataRefused(f"two {kind}s with the name {name!a}", "give each its own name")
    return Metadata(_text(root, "owner"), _text(root, "name"), _text(root, "group"), entries)


def parse(data: bytes, what: str = "metadata") -> "Element":
    check_document(data, what)
    try:
        root: Element = ElementTree.fromstring(data, forbid_dtd=True)
    except ParseError as error:
        line, _ = error.position
        raise errors.MetadataRefused(f"line {line}: {what} that are no XML: {error}", _HINT) from None
    except (DefusedXmlException, ValueError, LookupError) as error:
        raise errors.MetadataRefused(f"{what} that cannot be read: {error}", _HINT) from None
    return root


def _lines(data: bytes) -> list[int]:
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
    kind, name, mobile = NameKind(element.tag), _text(element, "name"), _text(element, "mobile")
    if name is None:
        raise errors.MetadataRefused(f"line {line}: a {element.tag} without <name>", _HINT)
    check_query(kind, name)
    if mobile not in _MOBILE:
        raise errors.MetadataRefused(f"line {line}: <mobile> is true or false, not {mobile!a:.60}")
    return Entry(kind, name, _text(element, "function"), _text(element, "location"), _MOBILE[mobile], line)


def _text(element: "Element", tag: str) -> str | None:
    found = element.findall(tag)
    if len(found) > 1:
        raise errors.MetadataRefused(f"<{element.tag}> has {len(found)} times <{tag}>", "once is enough")
    if not found:
        return None
    if len(found[0]):
        raise errors.MetadataRefused(f"<{tag}> has other elements inside", "it is a text")
    return (found[0].text or "").strip() or None


def check_query(kind: NameKind, which: str) -> tuple[NameKind, str]:
    if (kind is NameKind.NODE) is not (which == ""):
        said = "a topic or service is asked for by its name in the metadata"
        raise errors.MetadataRefused(said, "a node has none")
    if len(which) > MAX_WHICH or not which.isprintable():
        raise errors.MetadataRefused(f"{which[:60]!a} is no name of a {kind} in metadata")
    return kind, which


def frame(body: bytes) -> bytes:
    return len(body).to_bytes(HEAD) + body


def size(head: bytes, limit: int) -> int:
    found = int.from_bytes(head)
    if not 0 < found <= limit:
        raise errors.RulesExceeded(f"{found} bytes where at most {limit} are allowed")
    return found


answer_size: Final = partial(size, limit=MAX_ANSWER)


def write_request(request: NameRequest) -> bytes:
    queries: list[Value] = [[kind.value, which] for kind, which in request.queries]
    return encode([request.rules, request.metadata, queries, request.thesis_defaults])


def read_request(body: bytes) -> NameRequest:
    match decode(body, limit=MAX_REQUEST):
        case [bytes() as rules, bytes() as metadata, list() as queries, bool() as thesis]:
            return NameRequest(rules, metadata, tuple(map(_query, queries)), thesis)
        case _:
            raise EncodingError("a request of another form")


def _query(item: Value) -> tuple[NameKind, str]:
    match item:
        case [str() as kind, str() as which] if kind in set(NameKind):
            return NameKind(kind), which
    raise EncodingError("a query of another form")


def write_names(results: list[Result]) -> bytes:
    return encode([0, [_written(result) for result in results]])


def write_error(error: errors.RossecError) -> bytes:
    return encode(_written(error))


def _written(result: Result) -> Value:
    if isinstance(result, str):
        return [0, result]
    return [_ERRORS.index(type(result)) + 1, str(result)[:MAX_TEXT], result.hint[:MAX_TEXT]]


def read_names(body: bytes, count: int) -> list[Result]:
    try:
        value = decode(body, limit=MAX_ANSWER)
    except EncodingError as error:
        raise errors.RulesExceeded(_ODD) from error
    match value:
        case [0, list() as items] if len(items) == count:
            return [_result(item) for item in items]
        case [0, _]:
            raise errors.RulesExceeded(_ODD)
        case _:
            raise _error(value)


def _result(item: Value) -> Result:
    match item:
        case [0, str() as text] if len(text) <= MAX_TEXT:
            return text
    return _error(item)


def _error(item: Value) -> errors.RossecError:
    match item:
        case [int() as code, str() as message, str() as hint] if 0 < code <= len(_ERRORS):
            return _ERRORS[code - 1](message[:MAX_TEXT], hint[:MAX_TEXT])
    return errors.RulesExceeded(_ODD)


def check_proposed(text: str, *, thesis_defaults: bool = False) -> str:
    legal = text
    if thesis_defaults:  # which are no names of ROS
        parts = [each.replace("-", "_") if each in THESIS_DEFAULTS else each for each in text.split("/")]
        legal = "/".join(parts)
    try:
        check_name(legal)
    except NameRefused as error:
        raise errors.ProposedNameRefused(f"the rules do not give a name: {error}", error.hint) from None
    first = text.split("/")[1]
    if first in RESERVED:
        hint = f"no rule may put anything below /{first}"
        raise errors.ProposedNameRefused(f"the rules gave {text}, which is reserved", hint)
    return text
