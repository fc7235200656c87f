"""Rules applied: the one module that knows lxml, which runs in the confined process only.

Nothing is opened on a rule's behalf: no document type, no entity, no network, no file. Time and memory are
not bounded by libxslt, so the process is (`child`). Rules are elements of XSLT 1.0 and functions from lists,
and what has no namespace (`scan`): the first of two lines, as the transformation itself may open nothing
either.
"""

import re
from collections.abc import Iterator
from typing import Any, Final

from lxml import etree

from rossec.errors import MetadataRefused, NameUndefined, RossecError, RulesExceeded, RulesRefused
from rossec.naming import requests

XSLT: Final = "http://www.w3.org/1999/XSL/Transform"
STRINGS: Final = "http://exslt.org/strings"
XML: Final = "http://www.w3.org/XML/1998/namespace"
# Extension elements and functions need a namespace, so other namespaces are refused altogether.
_NAMESPACES: Final = frozenset({XSLT, STRINGS, XML})
_ROOTS: Final = frozenset({f"{{{XSLT}}}stylesheet", f"{{{XSLT}}}transform"})
# What reads or writes documents has no namespace of its own, and is not on this list.
_ELEMENTS: Final = frozenset(
    """stylesheet transform template apply-templates call-template with-param param variable if choose when
    otherwise for-each sort value-of copy copy-of text element attribute comment processing-instruction number
    key decimal-format output strip-space preserve-space message attribute-set
    """.split()  # noqa: SIM905 - read as a text
)
_ATTRIBUTES: Final = frozenset({"extension-element-prefixes", "use-when"})  # that are refused
# Functions of XPath 1.0 and XSLT 1.0 that compute from what is there. `document()` reads other documents;
# `generate-id()` gives an address in memory, another one each time; the others ask what the processor is. The
# tests of nodes, and operators before a parenthesis, look like calls.
ALLOWED: Final = frozenset(
    """last position count id local-name namespace-uri name string concat starts-with contains
    substring-before substring-after substring string-length normalize-space translate boolean not true false
    lang number sum floor ceiling round current key format-number node text comment processing-instruction
    and or div mod""".split()  # noqa: SIM905 - read as a text
)
STRING_FUNCTIONS: Final = frozenset(  # EXSLT's
    {"align", "concat", "decode-uri", "encode-uri", "padding", "replace", "split", "tokenize"}
)
EXPRESSIONS: Final = frozenset({"select", "test", "match", "use", "count", "from", "value"})  # attributes
_LITERAL: Final = re.compile(r""""[^"]*"|'[^']*'""")
_CALL: Final = re.compile(r"(?:([\w.-]+)\s*:\s*)?(?<![\w.-])([^\W\d][\w.-]*)\s*\(")
PARAMETER: Final = "parameter"
_ILLEGAL: Final = re.compile(r"[^A-Za-z0-9_/]")
_NAME: Final = re.compile(r"[A-Za-z_][\w.-]*", re.ASCII)
_KNOWN: Final = frozenset({"name", "path", "default"})
NAME: Final = "name"
_SHOWN: Final = 200
_XSLT_HINT: Final = "rules are a stylesheet of XSLT 1.0; for example: rossec namespace rules"
_SCAN_HINT: Final = "rules are XSLT 1.0 without imports, documents and extensions; see namespace.md"
_HINT: Final = 'write <parameter name="group" path="//node/group" default="unknown_group"/>'


def answer(request: requests.NameRequest) -> bytes:
    """The body of the answer to `request`: names, or why there are none.

    Without metadata the rules are compiled, and that is all.
    """
    try:
        sheet = compile_rules(request.rules, thesis_defaults=request.thesis_defaults)
        if not request.metadata:
            return requests.write_names([])  # the rules alone were asked about
        document = _parse(requests.check_document(request.metadata), MetadataRefused, "metadata")
        return requests.write_names([_result(sheet, document, *query) for query in request.queries])
    except RossecError as error:
        return requests.write_error(error)
    except MemoryError:
        return requests.write_error(RulesExceeded("the rules took more memory than allowed"))


def compile_rules(rules: bytes, *, thesis_defaults: bool = False) -> Any:
    tree = _parse(requests.check_rules(rules), RulesRefused, "rules")
    root = tree.getroot()
    if root.tag not in _ROOTS:
        raise RulesRefused(f"rules are an <xsl:stylesheet>, not <{root.tag[:60]}>", _XSLT_HINT)
    if root.get("version") != "1.0":
        raise RulesRefused(f"line {root.sourceline}: rules are of version 1.0", _XSLT_HINT)
    scan(root)
    expand(root, thesis_defaults=thesis_defaults)
    scan(root)  # the paths of the short form, which are expressions now
    try:
        return etree.XSLT(tree, access_control=etree.XSLTAccessControl.DENY_ALL, regexp=False)
    except etree.XSLTParseError as error:
        message = _one_line(str(error))
        raise RulesRefused(f"{_where(error)}rules that are no XSLT 1.0: {message}", _XSLT_HINT) from None


def expand(root: Any, *, thesis_defaults: bool = False) -> None:
    """Replace the short form `<parameter name path? default>`, which is the thesis's, by XSLT."""
    # A variable with the text of the node at `path` (by default the child `name`), or `default` where there
    # is none or nothing but space. A default with characters that ROS has not in names gets `_` for each of
    # them, unless the thesis's own defaults are asked for.
    for element in list(root.iter(PARAMETER)):
        unknown = sorted(set(element.attrib) - _KNOWN)
        if unknown or len(element) or (element.text or "").strip():
            raise RulesRefused(f"line {element.sourceline}: <parameter> has more than it may", _HINT)
        if _NAME.fullmatch(element.get("name", "")) is None:
            raise RulesRefused(f"line {element.sourceline}: <parameter> without a name", _HINT)
        if not element.get("path", "x").strip():
            raise RulesRefused(f"line {element.sourceline}: <parameter> with an empty path", _HINT)
        default = element.get("default", "")
        _replace(element, default if thesis_defaults else _ILLEGAL.sub("_", default))


def _replace(element: Any, default: str) -> None:
    name = element.get("name")
    path = element.get("path", name)
    variable = element.makeelement(f"{{{XSLT}}}variable", {"name": name})
    choose = _child(variable, "choose")
    given = _child(choose, "when", {"test": f"normalize-space({path}) != ''"})
    _child(given, "value-of", {"select": f"normalize-space({path})"})
    _child(_child(choose, "otherwise"), "text").text = default
    # What is wrong with it is told at the line of the short form, which is what its author has written.
    for made in variable.iter():
        made.sourceline = element.sourceline
    variable.tail = element.tail
    element.getparent().replace(element, variable)


def _child(parent: Any, name: str, attributes: dict[str, str] | None = None) -> Any:
    made = parent.makeelement(f"{{{XSLT}}}{name}", attributes or {})
    parent.append(made)
    return made


def scan(root: Any) -> None:
    for element in root.iter():
        if not isinstance(element.tag, str):
            if element.tag.__name__ != "Comment":
                raise _refusal(element, "a processing instruction or entity")
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
            is_expression = namespace == XSLT and _split(key)[1] in EXPRESSIONS
            _check_attribute(element, key, calls(value) if is_expression else calls_in_template(value))


def _check_attribute(element: Any, key: str, called: Iterator[tuple[str | None, str]]) -> None:
    _, name = _split(key)
    if name in _ATTRIBUTES:
        raise _refusal(element, f"the attribute {name}")
    for prefix, function in called:
        allowed, shown = ALLOWED, function
        if prefix is not None:
            known = element.nsmap.get(prefix) == STRINGS
            allowed, shown = STRING_FUNCTIONS if known else frozenset(), f"{prefix}:{function}"
        if function not in allowed:
            raise _refusal(element, f"the function {shown[:60]}()")


def calls(expression: str) -> Iterator[tuple[str | None, str]]:
    return _calls(_LITERAL.sub(" '' ", expression))


def calls_in_template(text: str) -> Iterator[tuple[str | None, str]]:
    """As `calls`, for an attribute value template (XSLT 1.0 section 7.6.2)."""
    # Where braces and literals end is the processor's to say: what looks like a call anywhere in such a text
    # counts as one.
    return _calls(text if "{" in text else "")


def _calls(text: str) -> Iterator[tuple[str | None, str]]:
    for found in _CALL.finditer(text):
        yield found[1], found[2]


def _split(tag: str) -> tuple[str, str]:
    if not tag.startswith("{"):
        return "", tag
    namespace, _, name = tag[1:].partition("}")
    return namespace, name


def _refusal(element: Any, what: str) -> RulesRefused:
    return RulesRefused(f"line {element.sourceline}: rules may not use {what}", _SCAN_HINT)


def _parse(data: bytes, refusal: type[RossecError], what: str) -> Any:
    never = {"resolve_entities": False, "load_dtd": False, "huge_tree": False, "remove_pis": False}
    parser = etree.XMLParser(no_network=True, strip_cdata=True, **never)
    try:
        return etree.ElementTree(etree.fromstring(data, parser))
    except etree.XMLSyntaxError as error:
        message = _one_line(error.msg or "malformed")
        raise refusal(f"line {error.lineno}: {what} that are no XML: {message}", "correct it there") from None


def _result(sheet: Any, document: Any, kind: requests.NameKind, which: str) -> requests.Result:
    text = etree.XSLT.strparam
    try:
        root = sheet(document, type=text(kind.value), name=text(which)).getroot()
    except etree.XSLTApplyError as error:
        return RulesRefused(f"{_where(error)}the rules failed: {_one_line(str(error))}")
    asked = f"the {kind}" if kind is requests.NameKind.NODE else f"the {kind} {which!a}"
    if root is None:
        return NameUndefined(f"the rules give no name for {asked}", "is it in the metadata?")
    if root.tag != NAME or len(root):
        return RulesRefused(f"the rules give <{str(root.tag)[:60]}> for {asked}, not one <name>")
    if any(True for _ in root.itersiblings()) or any(True for _ in root.itersiblings(preceding=True)):
        return NameUndefined(f"the rules give more than one name for {asked}")
    found: str = (root.text or "").strip()
    if len(found) > requests.MAX_TEXT:
        return RulesExceeded(f"the rules give a name of {len(found)} characters for {asked}")
    return found


def _where(error: Any) -> str:
    lines = [entry.line for entry in error.error_log if entry.line > 0]
    return f"line {lines[0]}: " if lines else ""


def _one_line(text: str) -> str:
    return " ".join(text.split())[:_SHOWN]
