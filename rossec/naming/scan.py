"""What rules may consist of: elements of XSLT 1.0 from a list, and what has no namespace.

A scan of the parsed rules before they are compiled. Extension elements and functions need a
namespace, so other namespaces are refused altogether; what reads or writes documents has none of
its own, and is not on the list. It is the first of two lines: the transformation itself may open
nothing, in a process that cannot.
"""

from typing import Any, Final

from rossec.errors import RulesRefused
from rossec.naming import expressions
from rossec.naming.sugar import XSLT

STRINGS: Final = "http://exslt.org/strings"
XML: Final = "http://www.w3.org/XML/1998/namespace"
_NAMESPACES: Final = frozenset({XSLT, STRINGS, XML})
_ELEMENTS: Final = frozenset({
    "stylesheet", "transform", "template", "apply-templates", "call-template", "with-param",
    "param", "variable", "if", "choose", "when", "otherwise", "for-each", "sort", "value-of",
    "copy", "copy-of", "text", "element", "attribute", "comment", "processing-instruction",
    "number", "key", "decimal-format", "output", "strip-space", "preserve-space", "message",
    "attribute-set",
})  # fmt: skip
_ATTRIBUTES: Final = frozenset({"extension-element-prefixes", "use-when"})
_HINT: Final = "rules are XSLT 1.0 without imports, documents and extensions; see namespace.md"


def scan(root: Any) -> None:
    """Check the tree of lxml below `root`.

    Raises:
        RulesRefused: something that rules may not use, with its line.
    """
    for element in root.iter():
        if not isinstance(element.tag, str):
            _check_other(element)
            continue
        for namespace in element.nsmap.values():
            if namespace not in _NAMESPACES:
                raise _refusal(element, f"the namespace {str(namespace)[:80]!a}")
        namespace, name = _split(element.tag)
        if namespace == XSLT and name not in _ELEMENTS:
            raise _refusal(element, f"<xsl:{name[:40]}>")
        if namespace == STRINGS:
            raise _refusal(element, "an extension element")
        for key, value in element.items():
            _check_attribute(element, key, value)


def _check_other(element: Any) -> None:
    """Comments remain; a processing instruction could name a stylesheet (`xml-stylesheet`)."""
    if element.tag.__name__ != "Comment":
        raise _refusal(element, "a processing instruction or entity")


def _check_attribute(element: Any, key: str, value: str) -> None:
    _, name = _split(key)
    if name in _ATTRIBUTES:
        raise _refusal(element, f"the attribute {name}")
    is_expression = _split(element.tag)[0] == XSLT and name in expressions.EXPRESSIONS
    calls = expressions.calls if is_expression else expressions.calls_in_template
    for prefix, function in calls(value):
        allowed = expressions.ALLOWED
        if prefix is not None:
            known = element.nsmap.get(prefix) == STRINGS
            allowed = expressions.STRING_FUNCTIONS if known else frozenset()
        if function not in allowed:
            shown = function if prefix is None else f"{prefix}:{function}"
            raise _refusal(element, f"the function {shown[:60]}()")


def _split(tag: str) -> tuple[str, str]:
    """`{namespace}name` of lxml."""
    if not tag.startswith("{"):
        return "", tag
    namespace, _, name = tag[1:].partition("}")
    return namespace, name


def _refusal(element: Any, what: str) -> RulesRefused:
    return RulesRefused(f"line {element.sourceline}: rules may not use {what}", _HINT)
