"""The parser of conditions: text to tokens to a tree. Syntax only; no types, no evaluation.

The language is a subset of CEL (the Common Expression Language, cel.dev) with CEL's syntax and precedence:
literals, `msg.<path>`, `now`, `timestamp("...")`, `! && ||`, one comparison or `in` per operand, `+ - *`, and
method calls.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import eq
from typing import Final, NamedTuple, TypeAlias

from grants.errors import ConditionRefused, GrantError
from grants.model import MAX_CONDITION

# No macros, no regular expressions, no functions of users: the cost of a condition is bounded by its text,
# which may come from whoever narrows a grant.
MAX_NODES: Final = 64
MAX_DEPTH: Final = 32

_TOKEN: Final = re.compile(
    r"""\s*(?:
      (?P<float>\d+\.\d+(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)
    | (?P<int>\d+)
    | (?P<string>"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*')
    | (?P<identifier>[A-Za-z_][A-Za-z0-9_]*)
    | (?P<operator>&&|\|\||[=!<>]=|[-+*!<>().,\[\]])
    )""",
    re.ASCII | re.VERBOSE,
)
_ESCAPE: Final = re.compile(r"\\(?:u([0-9a-fA-F]{4})|(.))", re.DOTALL)
_ESCAPES: Final = {"n": "\n", "r": "\r", "t": "\t", "\\": "\\", '"': '"', "'": "'"}
_NUMBER_END: Final = re.compile(r"[A-Za-z0-9_]", re.ASCII)

COMPARISONS: Final = ("==", "!=", "<", "<=", ">", ">=")


@dataclass(frozen=True)
class Literal:
    value: bool | int | float | str


@dataclass(frozen=True)
class Path:
    names: tuple[str, ...]


@dataclass(frozen=True)
class Now:
    """The time of evaluation."""


@dataclass(frozen=True)
class FunctionCall:
    target: "Expression | None"
    name: str
    arguments: tuple["Expression", ...]


@dataclass(frozen=True)
class Unary:
    operator: str
    operand: "Expression"


@dataclass(frozen=True)
class Binary:
    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True)
class MembershipTest:
    operand: "Expression"
    items: tuple["Expression", ...]


Expression: TypeAlias = Literal | Path | Now | FunctionCall | Unary | Binary | MembershipTest


class Token(NamedTuple):
    kind: str
    text: str
    at: int


def parse_expression(text: str) -> Expression:
    if len(text) > MAX_CONDITION:
        raise ConditionRefused(f"a condition of more than {MAX_CONDITION} characters")
    return _Parser(_tokens(text)).parse()


def _tokens(text: str) -> list[Token]:
    tokens: list[Token] = []
    at, end = 0, len(text.rstrip())
    while at < end:
        found = _TOKEN.match(text, at)
        if found is None or found.lastgroup is None:
            raise ConditionRefused(f"cannot read {text[at : at + 20].strip()!r} at character {at + 1}")
        token = Token(found.lastgroup, found[found.lastgroup], found.start(found.lastgroup) + 1)
        at = found.end()
        if token.kind in ("int", "float") and _NUMBER_END.match(text, at):
            raise ConditionRefused(f"cannot read a number at character {token.at}")
        tokens.append(token)
    return [*tokens, Token("end", "the end", len(text) + 1)]


class _Parser:
    def __init__(self, tokens: list[Token]) -> None:
        self._tokens = tokens
        self._position = 0
        self._nodes = 0
        self._depth = 0

    def parse(self) -> Expression:
        result = self._or()
        if self._next.kind != "end":
            raise self._unexpected()
        return result

    @property
    def _next(self) -> Token:
        return self._tokens[self._position]

    def _unexpected(self) -> ConditionRefused:
        return ConditionRefused(f"unexpected {self._next.text!r} at character {self._next.at}")

    def _take(self, *operators: str) -> str | None:
        token = self._next
        if token.text in operators and token.kind in ("operator", "identifier"):
            self._position += 1
            return token.text
        return None

    def _expect(self, operator: str) -> None:
        if self._take(operator) is None:
            raise self._unexpected()

    def _counted(self, node: Expression) -> Expression:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise ConditionRefused(f"a condition of more than {MAX_NODES} parts")
        return node

    def _chain(self, operand: Callable[[], Expression], *operators: str) -> Expression:
        left = operand()
        while operator := self._take(*operators):
            left = self._counted(Binary(operator, left, operand()))
        return left

    def _or(self) -> Expression:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ConditionRefused(f"a condition nested deeper than {MAX_DEPTH}")
        result = self._chain(lambda: self._chain(self._relation, "&&"), "||")
        self._depth -= 1
        return result

    def _relation(self) -> Expression:
        left = self._sum()
        if self._take("in"):
            self._expect("[")
            return self._counted(MembershipTest(left, self._items("]")))
        if operator := self._take(*COMPARISONS):
            left = self._counted(Binary(operator, left, self._sum()))
        return left

    def _sum(self) -> Expression:
        return self._chain(lambda: self._chain(self._unary, "*"), "+", "-")

    def _unary(self) -> Expression:
        operators: list[str] = []
        while operator := self._take("!", "-"):
            operators.append(operator)
        result = self._member()
        for operator in reversed(operators):
            result = self._counted(Unary(operator, result))
        return result

    def _member(self) -> Expression:
        result = self._primary()
        while self._take("."):
            if self._next.kind != "identifier":
                raise self._unexpected()
            name, self._position = self._next.text, self._position + 1
            if self._take("("):
                result = self._counted(FunctionCall(result, name, self._items(")")))
            elif isinstance(result, Path):
                result = Path((*result.names, name))
            else:
                raise ConditionRefused(f".{name}: only msg has fields")
        return result

    def _primary(self) -> Expression:
        token = self._next
        if self._take("("):
            inner = self._or()
            self._expect(")")
            return inner
        if token.kind in ("operator", "end"):
            raise self._unexpected()
        self._position += 1
        return self._counted(_literal(token) if token.kind != "identifier" else self._name(token))

    def _name(self, token: Token) -> Expression:
        if token.text in ("true", "false"):
            return Literal(token.text == "true")
        if token.text == "msg":
            return Path(())
        if token.text == "now":
            return Now()
        if self._take("("):
            return FunctionCall(None, token.text, self._items(")"))
        raise ConditionRefused(
            f"unknown name {token.text!r} at character {token.at}", "expected msg, now or timestamp()"
        )

    def _items(self, end: str) -> tuple[Expression, ...]:
        items: list[Expression] = []
        while not self._take(end):
            if items:
                self._expect(",")
            items.append(self._or())
        return tuple(items)


def _literal(token: Token) -> Literal:
    if token.kind == "int":
        value = int(token.text)
        if value >= 1 << 63:
            raise ConditionRefused(f"{token.text} is beyond 64 bits")
        return Literal(value)
    if token.kind == "float":
        return Literal(float(token.text))
    return Literal(_ESCAPE.sub(_unescape, token.text[1:-1]))


def _unescape(found: re.Match[str]) -> str:
    hexadecimal, simple = found.groups()
    character = _ESCAPES.get(simple, "\ud800") if simple else chr(int(hexadecimal, 16))
    if "\ud800" <= character <= "\udfff":
        raise ConditionRefused(f"unknown escape {found[0]!r} in a text")
    return character


def fields_read(text: str) -> list[str]:
    """The paths of the fields that the condition `text` names, each once."""
    return list(dict.fromkeys(_paths(parse_expression(text))))


def _paths(node: Expression) -> Iterator[str]:
    if isinstance(node, Path):
        yield ".".join(node.names)
    for below in _below(node):
        yield from _paths(below)


def _below(node: Expression) -> tuple[Expression, ...]:
    match node:
        case Unary(_, operand):
            return (operand,)
        case Binary(_, left, right):
            return (left, right)
        case MembershipTest(operand, items):
            return (operand, *items)
        case FunctionCall(target, _, arguments):
            return arguments if target is None else (target, *arguments)
        case _:
            return ()


def reads(text: str, field: str) -> bool:
    """Whether the condition `text` reads the field at `field`, what it lies in, or a part of it.

    A text that is no condition is taken to read everything.
    """
    try:
        read = fields_read(text)
    except GrantError:
        return True
    asked = _steps(field)
    return any(all(map(eq, asked, _steps(path))) for path in read)


def _steps(path: str) -> list[str]:
    return path.replace("[*]", "").split(".")
