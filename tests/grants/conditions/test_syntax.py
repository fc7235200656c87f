"""The syntax of conditions: precedence, and what every token becomes."""

import pytest

from grants.conditions.syntax import (
    Binary,
    FunctionCall,
    Literal,
    MembershipTest,
    Now,
    Path,
    Unary,
    parse_expression,
)
from grants.errors import ConditionRefused

A, B, C = Path(("a",)), Path(("b",)), Path(("c",))

TREES = {
    "msg.a || msg.b && msg.c": Binary("||", A, Binary("&&", B, C)),
    "msg.a || msg.b || msg.c": Binary("||", Binary("||", A, B), C),
    "(msg.a || msg.b) && msg.c": Binary("&&", Binary("||", A, B), C),
    "msg.a == msg.b + msg.c * 2": Binary("==", A, Binary("+", B, Binary("*", C, Literal(2)))),
    "!msg.a == msg.b": Binary("==", Unary("!", A), B),
    "-1 - -1.5": Binary("-", Unary("-", Literal(1)), Unary("-", Literal(1.5))),
    "msg.a in ['x', \"y\"]": MembershipTest(A, (Literal("x"), Literal("y"))),
    "msg.a in []": MembershipTest(A, ()),
    "now.getHours('UTC') >= 8": Binary(">=", FunctionCall(Now(), "getHours", (Literal("UTC"),)), Literal(8)),
    "timestamp('x')": FunctionCall(None, "timestamp", (Literal("x"),)),
    "msg.a.contains(msg.b)": FunctionCall(A, "contains", (B,)),
    "f(1, 2)": FunctionCall(None, "f", (Literal(1), Literal(2))),
    "true": Literal(True),
    "false": Literal(False),
    "1e3": Literal(1000.0),
    r"'\'\"\\\n\r\t\u00e9'": Literal("'\"\\\n\r\té"),
    "'&& in true'": Literal("&& in true"),
    "msg": Path(()),
}


@pytest.mark.parametrize("text", TREES)
def test_a_text_is_parsed_to_its_tree(text: str) -> None:
    assert parse_expression(text) == TREES[text]
    assert parse_expression(f"  ({text}) ") == TREES[text]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 +", "unexpected 'the end' at character 4"),
        ("1 2", "unexpected '2' at character 3"),
        ("(1", "unexpected 'the end'"),
        ("a", "unknown name 'a' at character 1"),
        ("now.x", ".x: only msg has fields"),
        ("msg.1", "cannot read a number|unexpected"),
        ("msg.(", "unexpected '\\('"),
        ("$", r"cannot read '\$' at character 1"),
        ("'\\x'", "unknown escape"),
        (r"'\udfff'", "unknown escape"),
        ("1x", "cannot read a number at character 1"),
        ("9" * 19, "is beyond 64 bits"),
        ("f(1 2)", "unexpected '2'"),
        ("true" * 300, "more than 1000 characters"),
        ("(" * 33 + "1", "nested deeper than 32"),
        ("-" * 70 + "1", "more than 64 parts"),
    ],
)
def test_invalid_syntax_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConditionRefused, match=message):
        parse_expression(text)
