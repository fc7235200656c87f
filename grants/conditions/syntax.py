"""Reading conditions: text to tokens to a tree. Syntax only; no types, no evaluation.

The language is a subset of CEL (the Common Expression Language, cel.dev) with CEL's syntax and
precedence: literals, `msg.<path>`, `now`, `timestamp("...")`, `! && ||`, one comparison or `in`
per operand, `+ - *`, and method calls. No macros, no regular expressions, no user functions: the
cost of a condition is bounded by its text.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from grants.errors import ConditionRefused
from grants.model import MAX_CONDITION

MAX_NODES: Final = 64
MAX_DEPTH: Final = 32

_TOKEN: Final = re.compile(
    r"""\s*(?:
      (?P<float>\d+\.\d+(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)
    | (?P<int>\d+)
    | (?P<string>"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*')
    | (?P<word>[A-Za-z_][A-Za-z0-9_]*)
    | (?P<sign>&&|\|\||[=!<>]=|[-+*!<>().,\[\]])
    )""",
    re.ASCII | re.VERBOSE,
)
_ESCAPE: Final = re.compile(r"\\(?:u([0-9a-fA-F]{4})|(.))", re.DOTALL)
_ESCAPES: Final = {"n": "\n", "r": "\r", "t": "\t", "\\": "\\", '"': '"', "'": "'"}
_NUMBER_END: Final = re.compile(r"[A-Za-z0-9_]", re.ASCII)

COMPARISONS: Final = ("==", "!=", "<", "<=", ">", ">=")


@dataclass(frozen=True)
class Literal:
    """A value written in the text."""

    value: bool | int | float | str


@dataclass(frozen=True)
class Path:
    """`msg.a.b`: a field of the message."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Now:
    """The time of the decision."""


@dataclass(frozen=True)
class FunctionCall:
    """`target.name(arguments)`, or `name(arguments)` without a target."""

    target: "Expression | None"
    name: str
    arguments: tuple["Expression", ...]


@dataclass(frozen=True)
class Unary:
    """`!` or `-`."""

    sign: str
    operand: "Expression"


@dataclass(frozen=True)
class Binary:
    """Two operands and what stands between them."""

    sign: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True)
class Among:
    """`operand in [a, b]`."""

    operand: "Expression"
    items: tuple["Expression", ...]


Expression: TypeAlias = Literal | Path | Now | FunctionCall | Unary | Binary | Among


class Token(NamedTuple):
    """A word of the text and its kind; the end has kind "end"."""

    kind: str
    text: str
    at: int


def parse_expression(text: str) -> Expression:
    """Read a condition.

    Raises:
        ConditionRefused: outside the language, or larger than its limits.
    """
    if len(text) > MAX_CONDITION:
        raise ConditionRefused(f"a condition of more than {MAX_CONDITION} characters")
    return _Parser(_tokens(text)).whole()


def _tokens(text: str) -> list[Token]:
    tokens: list[Token] = []
    at, end = 0, len(text.rstrip())
    while at < end:
        found = _TOKEN.match(text, at)
        if found is None or found.lastgroup is None:
            raise ConditionRefused(
                f"cannot read {text[at : at + 20].strip()!r} at character {at + 1}"
            )
        token = Token(found.lastgroup, found[found.lastgroup], found.start(found.lastgroup) + 1)
        at = found.end()
        if token.kind in ("int", "float") and _NUMBER_END.match(text, at):
            raise ConditionRefused(f"cannot read a number at character {token.at}")
        tokens.append(token)
    return [*tokens, Token("end", "the end", len(text) + 1)]


class _Parser:
    """Recursive descent, one method per level of precedence, bounded in depth and nodes."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens = tokens
        self._at = 0
        self._nodes = 0
        self._depth = 0

    def whole(self) -> Expression:
        result = self._either()
        if self._next.kind != "end":
            raise self._unexpected()
        return result

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _unexpected(self) -> ConditionRefused:
        return ConditionRefused(f"unexpected {self._next.text!r} at character {self._next.at}")

    def _take(self, *signs: str) -> str | None:
        """The next sign (or `in`) if it is one of these."""
        token = self._next
        if token.text in signs and token.kind in ("sign", "word"):
            self._at += 1
            return token.text
        return None

    def _need(self, sign: str) -> None:
        if self._take(sign) is None:
            raise self._unexpected()

    def _node(self, node: Expression) -> Expression:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise ConditionRefused(f"a condition of more than {MAX_NODES} parts")
        return node

    def _chain(self, operand: Callable[[], Expression], *signs: str) -> Expression:
        left = operand()
        while sign := self._take(*signs):
            left = self._node(Binary(sign, left, operand()))
        return left

    def _either(self) -> Expression:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ConditionRefused(f"a condition nested deeper than {MAX_DEPTH}")
        result = self._chain(self._both, "||")
        self._depth -= 1
        return result

    def _both(self) -> Expression:
        return self._chain(self._relation, "&&")

    def _relation(self) -> Expression:
        left = self._sum()
        if self._take("in"):
            self._need("[")
            return self._node(Among(left, self._items("]")))
        if sign := self._take(*COMPARISONS):
            left = self._node(Binary(sign, left, self._sum()))
        return left

    def _sum(self) -> Expression:
        return self._chain(self._product, "+", "-")

    def _product(self) -> Expression:
        return self._chain(self._unary, "*")

    def _unary(self) -> Expression:
        signs: list[str] = []
        while sign := self._take("!", "-"):
            signs.append(sign)
        result = self._member()
        for sign in reversed(signs):
            result = self._node(Unary(sign, result))
        return result

    def _member(self) -> Expression:
        result = self._primary()
        while self._take("."):
            name = self._word()
            if self._take("("):
                result = self._node(FunctionCall(result, name, self._items(")")))
            elif isinstance(result, Path):
                result = Path((*result.names, name))
            else:
                raise ConditionRefused(f"only msg has fields, not what is before .{name}")
        return result

    def _word(self) -> str:
        if self._next.kind != "word":
            raise self._unexpected()
        self._at += 1
        return self._tokens[self._at - 1].text

    def _primary(self) -> Expression:
        token = self._next
        if self._take("("):
            inner = self._either()
            self._need(")")
            return inner
        if token.kind in ("sign", "end"):
            raise self._unexpected()
        self._at += 1
        return self._node(_literal(token) if token.kind != "word" else self._name(token))

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
            f"unknown name {token.text!r} at character {token.at}",
            "there are msg, now, timestamp()",
        )

    def _items(self, end: str) -> tuple[Expression, ...]:
        items: list[Expression] = []
        while not self._take(end):
            if items:
                self._need(",")
            items.append(self._either())
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
