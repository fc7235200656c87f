"""What is checked in a text of XML before any parser sees it. Pure.

Rules, metadata and launch files come from people and nodes. A document type is refused by its
characters, since it is what entities are declared in (billion laughs, XXE), and so is every
encoding that could hide one: only those in which ASCII is ASCII remain. Parsers guess others by the
first bytes (EBCDIC), so these are `<` in ASCII.
"""

import re
from typing import Final

from rossec.errors import MetadataRefused, RossecError, RulesRefused

MAX_INPUT: Final = 256 * 1024
_ENCODINGS: Final = frozenset({"utf-8", "iso-8859-1", "us-ascii", "ascii"})
_DECLARED: Final = re.compile(rb"""<\?xml\s[^>]*?encoding\s*=\s*["']([^"'>]*)["'][^>]*\?>""")
_DECLARATION: Final = re.compile(rb"<!(?:DOCTYPE|ENTITY|ELEMENT|ATTLIST|NOTATION)", re.IGNORECASE)
_BOM: Final = b"\xef\xbb\xbf"
_SPACE: Final = b" \t\r\n"


def check_rules(data: bytes) -> bytes:
    """Return `data` if it may be parsed as rules.

    Raises:
        RulesRefused: too long, with a document type, or in another encoding.
    """
    return _check(data, "rules", RulesRefused)


def check_document(data: bytes, what: str = "metadata") -> bytes:
    """Return `data` if it may be parsed as `what`: metadata, or a launch file.

    Raises:
        MetadataRefused: as for `check_rules`.
    """
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
        raise refusal(
            f"line {line}: {what} with a document type or entities", "leave <!DOCTYPE ...> out"
        )
    encoding = _encoding(data)
    if encoding not in _ENCODINGS or b"\0" in data:
        raise refusal(f"{what} in the encoding {encoding[:40]!a}", "use UTF-8 or ISO-8859-1")
    if not data.removeprefix(_BOM).lstrip(_SPACE).startswith(b"<"):
        raise refusal(f"line 1: {what} that begin with no element", "an XML document is needed")
    return data


def _encoding(data: bytes) -> str:
    """The declared encoding in lower case, UTF-8 where none is declared."""
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
