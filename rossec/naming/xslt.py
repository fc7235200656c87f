"""Rules applied: the one module that knows lxml, which runs in the confined process only.

Nothing is opened on a rule's behalf: no document type, no entity, no network, no file. Time and
memory are not bounded by libxslt, so the process is (`child`).
"""

from typing import Any, Final

from lxml import etree

from rossec.errors import MetadataRefused, NameUndefined, RossecError, RulesExceeded, RulesRefused
from rossec.naming import documents, frames
from rossec.naming.frames import NameRequest, Result
from rossec.naming.metadata import Kind
from rossec.naming.scan import scan
from rossec.naming.sugar import XSLT, expand

NAME: Final = "name"
_SHOWN: Final = 200
_ROOTS: Final = frozenset({f"{{{XSLT}}}stylesheet", f"{{{XSLT}}}transform"})
_XSLT_HINT: Final = "rules are a stylesheet of XSLT 1.0; for example: rossec namespace rules"


def answer(request: NameRequest) -> bytes:
    """The body of the answer to `request`: names, or why there are none.

    Without metadata the rules are compiled, and that is all.
    """
    try:
        sheet = compile_rules(request.rules, thesis_defaults=request.thesis_defaults)
        if not request.metadata:
            return frames.write_names([])  # the rules alone were asked about
        document = _parse(documents.check_document(request.metadata), MetadataRefused, "metadata")
        return frames.write_names([_result(sheet, document, *query) for query in request.queries])
    except RossecError as error:
        return frames.write_error(error)
    except MemoryError:
        return frames.write_error(RulesExceeded("the rules took more memory than allowed"))


def compile_rules(rules: bytes, *, thesis_defaults: bool = False) -> Any:
    """The transformation that `rules` are.

    Raises:
        RulesRefused: malformed, or with something that rules may not use; it names the line.
    """
    tree = _parse(documents.check_rules(rules), RulesRefused, "rules")
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
        raise RulesRefused(
            f"{_where(error)}rules that are no XSLT 1.0: {message}", _XSLT_HINT
        ) from None


def _parse(data: bytes, refusal: type[RossecError], what: str) -> Any:
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
        remove_pis=False, strip_cdata=True,
    )  # fmt: skip
    try:
        return etree.ElementTree(etree.fromstring(data, parser))
    except etree.XMLSyntaxError as error:
        message = _one_line(error.msg or "malformed")
        raise refusal(
            f"line {error.lineno}: {what} that are no XML: {message}", "correct it there"
        ) from None


def _result(sheet: Any, document: Any, kind: Kind, which: str) -> Result:
    try:
        return _name(sheet, document, kind, which)
    except RossecError as error:
        return error


def _name(sheet: Any, document: Any, kind: Kind, which: str) -> str:
    """The text of the one `<name>` that the rules give."""
    made = _apply(
        sheet, document,
        type=etree.XSLT.strparam(kind.value), name=etree.XSLT.strparam(which),
    )  # fmt: skip
    root = made.getroot()
    asked = f"the {kind}" if kind is Kind.NODE else f"the {kind} {which!a}"
    if root is None:
        raise NameUndefined(f"the rules give no name for {asked}", "is it in the metadata?")
    if root.tag != NAME or len(root):
        raise RulesRefused(f"the rules give <{str(root.tag)[:60]}> for {asked}, not one <name>")
    if any(True for _ in root.itersiblings()) or any(
        True for _ in root.itersiblings(preceding=True)
    ):
        raise NameUndefined(f"the rules give more than one name for {asked}")
    text = (root.text or "").strip()
    if len(text) > frames.MAX_TEXT:
        raise RulesExceeded(f"the rules give a name of {len(text)} characters for {asked}")
    return text


def _apply(sheet: Any, document: Any, **parameters: Any) -> Any:
    try:
        return sheet(document, **parameters)
    except etree.XSLTApplyError as error:
        raise RulesRefused(f"{_where(error)}the rules failed: {_one_line(str(error))}") from None


def _where(error: Any) -> str:
    lines = [entry.line for entry in error.error_log if entry.line > 0]
    return f"line {lines[0]}: " if lines else ""


def _one_line(text: str) -> str:
    return " ".join(text.split())[:_SHOWN]
