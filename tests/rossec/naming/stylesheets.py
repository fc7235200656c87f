"""Rules for tests."""

from rossec.naming import rule_runner
from rossec.naming.requests import NameKind, NameRequest

RULES = rule_runner.shipped_rules()
PHONE = rule_runner.shipped_example("phone.xml")
NODE = (NameKind.NODE, "")


def sheet(body: str, *, attributes: str = "", top: str = "") -> bytes:
    """Rules with `body` in the one template, for the root."""
    return (
        '<xsl:stylesheet version="1.0" xmlns:xsl="http://www.w3.org/1999/XSL/Transform"'
        f' {attributes}>\n{top}\n<xsl:template match="/">\n{body}\n</xsl:template></xsl:stylesheet>'
    ).encode()


def gives(expression: str, **more: str) -> bytes:
    """Rules whose name is the value of an expression."""
    return sheet(f'<name><xsl:value-of select="{expression}"/></name>', **more)


def request(rules: bytes, document: bytes = PHONE) -> NameRequest:
    """The node's name is asked for."""
    return NameRequest(rules, document, (NODE,))
