"""Which functions an XPath expression of rules calls, and where expressions stand. Pure.

Only functions of the list may be called: those of XPath 1.0 and XSLT 1.0 that compute from what is
there, and EXSLT's for strings. `document()` reads other documents; `generate-id()` gives an address
in memory, another one each time; the others ask what the processor is.
"""

import re
from collections.abc import Iterator
from typing import Final

ALLOWED: Final = frozenset({
    "last", "position", "count", "id", "local-name", "namespace-uri", "name", "string", "concat",
    "starts-with", "contains", "substring-before", "substring-after", "substring", "string-length",
    "normalize-space", "translate", "boolean", "not", "true", "false", "lang", "number", "sum",
    "floor", "ceiling", "round", "current", "key", "format-number",
    "node", "text", "comment", "processing-instruction",  # tests of nodes, which look the same
    "and", "or", "div", "mod",  # operators before a parenthesis
})  # fmt: skip
STRING_FUNCTIONS: Final = frozenset({
    "align", "concat", "decode-uri", "encode-uri", "padding", "replace", "split", "tokenize",
})  # fmt: skip
EXPRESSIONS: Final = frozenset({"select", "test", "match", "use", "count", "from", "value"})
_LITERAL: Final = re.compile(r""""[^"]*"|'[^']*'""")
_CALL: Final = re.compile(r"(?:([\w.-]+)\s*:\s*)?(?<![\w.-])([^\W\d][\w.-]*)\s*\(")


def calls(expression: str) -> Iterator[tuple[str | None, str]]:
    """Prefix, if any, and name of every function that `expression` calls."""
    return _calls(_LITERAL.sub(" '' ", expression))


def calls_in_template(text: str) -> Iterator[tuple[str | None, str]]:
    """As `calls`, for an attribute value template (XSLT 1.0 section 7.6.2).

    Where braces and literals end is the processor's to say: what looks like a call anywhere in such
    a text counts as one.
    """
    return _calls(text if "{" in text else "")


def _calls(text: str) -> Iterator[tuple[str | None, str]]:
    for found in _CALL.finditer(text):
        yield found[1], found[2]
