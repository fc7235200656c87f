"""Which fields a condition reads: that a message comes tells something of each of them. Pure."""

from collections.abc import Iterator
from operator import eq

from grants.conditions.syntax import (
    Binary,
    Expression,
    FunctionCall,
    Membership,
    Path,
    Unary,
    parse_expression,
)
from grants.errors import GrantError


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
        case Membership(operand, items):
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
