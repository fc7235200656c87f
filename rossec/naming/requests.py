"""What is checked in a text of XML before any parser sees it. Pure.

Rules, metadata and launch files come from people and nodes. A document type is refused by its
characters, since it is what entities are declared in (billion laughs, XXE), and so is every
encoding that could hide one: only those in which ASCII is ASCII remain. Parsers guess others by the
first bytes (EBCDIC), so these are `<` in ASCII.

The metadata of a node: who owns it, what it is, which topics and services it has.

The elements are the thesis's (section 4.4, appendix A). Others may stand beside them: rules may
use whatever they like, and only what names have to be found for is read here. Metadata are claims
of a node: nothing is granted by them.

Requests to the process that applies rules, and its answers. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR:
`[rules, metadata, [[kind, which], ...], thesis_defaults]` one way; without metadata the rules are
compiled only. The other way `[0, [result, ...]]` with `[0, text]` or `[code, message, hint]` for
each query, or `[code, message, hint]`. An answer is not trusted: a process that was taken over may
have written it.

The names that rules give, checked: absolute ROS names, and none that others trust. Pure.

What lies below these names is not for rules: identities that nodes trust (`/master`, `/ca`,
`/relay`), those of the own services, names of other domains (`/remote`), and topics that every
node may use without a grant.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import ParseError
from xml.parsers import expat

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, NameRefused
from ca.names import check_name
from rossec.errors import (
    MetadataRefused,
    NameUndefined,
    ProposedNameRefused,
    RossecError,
    RulesExceeded,
    RulesNotConfined,
    RulesRefused,
)

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


MAX_INPUT: Final = 256 * 1024
_ENCODINGS: Final = frozenset({"utf-8", "iso-8859-1", "us-ascii", "ascii"})
_DECLARED: Final = re.compile(rb"""<\?xml\s[^>]*?encoding\s*=\s*["']([^"'>]*)["'][^>]*\?>""")
_DECLARATION: Final = re.compile(rb"<!(?:DOCTYPE|ENTITY|ELEMENT|ATTLIST|NOTATION)", re.IGNORECASE)
_BOM: Final = b"\xef\xbb\xbf"
_SPACE: Final = b" \t\r\n"


def check_rules(data: bytes) -> bytes:
    """Return `data` if it may be parsed as rules."""
    return _check(data, "rules", RulesRefused)


def check_document(data: bytes, what: str = "metadata") -> bytes:
    """Return `data` if it may be parsed as `what`: metadata, or a launch file."""
    return _check(data, what, MetadataRefused)


def _check(data: bytes, what: str, refusal: type[RossecError]) -> bytes:
    if len(data) > MAX_INPUT:
        raise refusal(
            f"{len(data)} bytes of {what} where at most {MAX_INPUT} are allowed",
            "metadata of one node are some lines; rules are a few hundred at most",
        )
    if not data.strip():
        raise refusal(f"empty {what}", "an XML document is needed")
    found = _DECLARATION.search(data)
    if found is not None:
        line = data.count(b"\n", 0, found.start()) + 1
        raise refusal(f"line {line}: {what} with a document type or entities", "leave <!DOCTYPE ...> out")
    encoding = _encoding(data)
    if encoding not in _ENCODINGS or b"\0" in data:
        raise refusal(f"{what} in the encoding {encoding[:40]!a}", "use UTF-8 or ISO-8859-1")
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
    owner: str | None = None
    name: str | None = None
    group: str | None = None
    entries: tuple[Entry, ...] = ()

    def queries(self) -> Iterator[tuple[Kind, str]]:
        yield Kind.NODE, ""
        for entry in self.entries:
            yield entry.kind, entry.name


def read(data: bytes) -> Metadata:
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
    if (kind is Kind.NODE) is not (which == ""):
        raise MetadataRefused(
            "a topic or service is asked for by its name in the metadata", "a node has none"
        )
    if len(which) > MAX_WHICH or not which.isprintable():
        raise MetadataRefused(f"{which[:60]!a} is no name of a {kind} in metadata")
    return kind, which


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
    name = _text(element, "name")
    if name is None:
        raise MetadataRefused(f"line {line}: a {element.tag} without <name>", _HINT)
    check_query(Kind(element.tag), name)
    mobile = _text(element, "mobile")
    if mobile not in _MOBILE:
        raise MetadataRefused(f"line {line}: <mobile> is true or false, not {mobile!a:.60}")
    return Entry(
        Kind(element.tag), name, _text(element, "function"), _text(element, "location"), _MOBILE[mobile], line
    )


def _text(element: "Element", tag: str) -> str | None:
    found = element.findall(tag)
    if len(found) > 1:
        raise MetadataRefused(f"<{element.tag}> has {len(found)} times <{tag}>", "once is enough")
    if not found:
        return None
    if len(found[0]):
        raise MetadataRefused(f"<{tag}> has other elements inside", "it is a text")
    return (found[0].text or "").strip() or None


HEAD: Final = 4
MAX_REQUEST: Final = 2 * MAX_INPUT + (MAX_ENTRIES + 1) * (4 * MAX_WHICH + 16) + 64
MAX_ANSWER: Final = 1024 * 1024
READY: Final = b"\x00"  # the body of the first frame of a process, once it is confined
MAX_TEXT: Final = 1024  # characters of a name; legal ones have 255
_ERRORS: Final = (RulesRefused, MetadataRefused, NameUndefined, RulesExceeded, RulesNotConfined)
_ODD: Final = "the process that applies rules answers in another form"


@dataclass(frozen=True)
class NameRequest:
    rules: bytes
    metadata: bytes
    queries: tuple[tuple[Kind, str], ...] = ()
    thesis_defaults: bool = False


Result = str | RossecError


def frame(body: bytes) -> bytes:
    return len(body).to_bytes(HEAD) + body


def size(head: bytes, limit: int) -> int:
    """The number of bytes after a frame's head."""
    found = int.from_bytes(head)
    if not 0 < found <= limit:
        raise RulesExceeded(f"{found} bytes where at most {limit} are allowed")
    return found


def write_request(request: NameRequest) -> bytes:
    queries: list[Value] = [[kind.value, which] for kind, which in request.queries]
    return encode([request.rules, request.metadata, queries, request.thesis_defaults])


def read_request(body: bytes) -> NameRequest:
    match decode(body, limit=MAX_REQUEST):
        case [bytes() as rules, bytes() as metadata, list() as queries, bool() as thesis]:
            return NameRequest(rules, metadata, tuple(map(_query, queries)), thesis)
        case _:
            raise EncodingError("a request of another form")


def _query(item: Value) -> tuple[Kind, str]:
    match item:
        case [str() as kind, str() as which] if kind in set(Kind):
            return Kind(kind), which
        case _:
            raise EncodingError("a query of another form")


def write_names(results: list[Result]) -> bytes:
    return encode([0, [_written(result) for result in results]])


def write_error(error: RossecError) -> bytes:
    return encode(_written(error))


def _written(result: Result) -> Value:
    if isinstance(result, str):
        return [0, result]
    return [_ERRORS.index(type(result)) + 1, str(result)[:MAX_TEXT], result.hint[:MAX_TEXT]]


def read_names(body: bytes, count: int) -> list[Result]:
    items = _value(body)
    if not isinstance(items, list) or len(items) != count:
        raise RulesExceeded(_ODD)
    return [_result(item) for item in items]


def _value(body: bytes) -> Value:
    try:
        value = decode(body, limit=MAX_ANSWER)
    except EncodingError as error:
        raise RulesExceeded(_ODD) from error
    match value:
        case [0, found]:
            return found
        case _:
            raise _error(value)


def _result(item: Value) -> Result:
    match item:
        case [0, str() as text] if len(text) <= MAX_TEXT:
            return text
        case _:
            return _error(item)


def _error(item: Value) -> RossecError:
    match item:
        case [int() as code, str() as message, str() as hint] if 0 < code <= len(_ERRORS):
            return _ERRORS[code - 1](message[:MAX_TEXT], hint[:MAX_TEXT])
        case _:
            return RulesExceeded(_ODD)


RESERVED: Final = frozenset(
    {
        "remote",
        "master",
        "ca",
        "relay",
        "gateway",
        "router",
        "console",
        "border",
        "namespace",
        "sidecar",
        "rossec",
        "rosout",
        "rosout_agg",
        "clock",
    }
)
THESIS_DEFAULTS: Final = ("unknown-group", "unknown-node", "unknown-location")


def check_proposed(text: str, *, thesis_defaults: bool = False) -> str:
    try:
        check_name(_legal(text) if thesis_defaults else text)
    except NameRefused as error:
        raise ProposedNameRefused(f"the rules do not give a name: {error}", error.hint) from None
    first = text.split("/")[1]
    if first in RESERVED:
        raise ProposedNameRefused(
            f"the rules gave {text}, which is reserved", f"no rule may put anything below /{first}"
        )
    return text


def _legal(text: str) -> str:
    return "/".join(
        segment.replace("-", "_") if segment in THESIS_DEFAULTS else segment for segment in text.split("/")
    )
