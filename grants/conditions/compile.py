"""Conditions on messages and time: typed against the layout, compiled to read only what they name.

A condition admits a message if its value is exactly True; an error denies. Deviations from CEL are those of
docs/spec/grant.md section 5, all of them towards no: integers of all sizes are `int`; `int` and `double` may
be compared, not added. `now` is the host's clock.
"""

import math
import re
import struct
from collections.abc import Callable
from datetime import datetime, tzinfo
from functools import lru_cache
from operator import contains
from typing import Final, TypeAlias

from grants.conditions.syntax import (
    COMPARISONS,
    Binary,
    Expression,
    Literal,
    MembershipTest,
    Now,
    Path,
    Unary,
    parse_expression,
)
from grants.errors import ConditionRefused
from grants.filters.layout import (
    LAYOUT_ERRORS,
    Buffer,
    Cursor,
    Layout,
    Primitive,
    SourceWriter,
    Struct,
    Text,
    Type,
    expression,
)

# Months and days of the year count from 0 as in CEL, `getDate` from 1, Sunday is 0. Time zones come from
# the system's database and are loaded when the condition is compiled, never later.
FIELDS: Final[dict[str, Callable[[datetime], int]]] = {
    "getFullYear": lambda time: time.year,
    "getMonth": lambda time: time.month - 1,
    "getDate": lambda time: time.day,
    "getDayOfMonth": lambda time: time.day - 1,
    "getDayOfWeek": lambda time: time.isoweekday() % 7,
    "getDayOfYear": lambda time: time.timetuple().tm_yday - 1,
    "getHours": lambda time: time.hour,
    "getMinutes": lambda time: time.minute,
    "getSeconds": lambda time: time.second,
}

_METHODS: Final[dict[str, Callable[[str, str], bool]]] = {
    "startsWith": str.startswith,
    "endsWith": str.endswith,
    "contains": contains,
}
_NUMBERS: Final = ("int", "double")
_ERRORS: Final = (*LAYOUT_ERRORS, ArithmeticError, OSError)  # OSError: a time beyond the calendar
_ZONE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_+-]*(?:/[A-Za-z0-9_+-]+)*", re.ASCII)
_TIMESTAMP: Final = re.compile(
    r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:Z|[+-]\d\d:\d\d)", re.ASCII
)  # RFC 3339, whole seconds


def clock_field(name: str, zone: str) -> Callable[[int], int]:
    """The function from seconds since the epoch to the field `name` in `zone`."""
    info, field = _zone(zone), FIELDS[name]
    # The last second is cached, since most messages share it.
    return lru_cache(maxsize=1)(lambda now: field(datetime.fromtimestamp(now, info)))


def parse_timestamp(text: str) -> int:
    """Seconds since the epoch of an RFC 3339 time such as `2026-11-20T18:00:00Z`."""
    try:
        if _TIMESTAMP.fullmatch(text) is not None:
            return int(datetime.fromisoformat(text).timestamp())
    except (ValueError, OverflowError):
        pass
    raise ConditionRefused(f"not a time: {text[:40]!r}", "for example 2026-11-20T18:00:00Z")


def _zone(zone: str) -> tzinfo:
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError  # noqa: PLC0415 - 0.3 MB, few conditions need it

    # A name outside the database must not be used as a path.
    matched = _ZONE.fullmatch(zone)
    try:
        return ZoneInfo(zone if matched is not None else "")
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ConditionRefused(
            f"unknown time zone {zone[:40]!r}", "for example Europe/Zurich or UTC"
        ) from None


# Whether a message (serialized) is admitted at a time (seconds since the epoch). Calling it does not raise:
# an error is False.
Condition: TypeAlias = Callable[[Buffer, int], bool]


def check_syntax(text: str) -> None:
    """Check the syntax of `text`, not the fields it names."""
    parse_expression(text)


def compile_condition(layout: Layout | None, text: str) -> Condition:
    """Compile `text` for messages of `layout`; None if there is no message."""
    compiler = _Compiler(layout)
    kind, code = compiler.compile(parse_expression(text))
    if kind != "bool":
        raise ConditionRefused(f"a condition must be true or false, this is a {kind}: {text}")
    return compiler.finish(code)


class _Compiler:
    def __init__(self, layout: Layout | None) -> None:
        self._layout = layout
        self._source = SourceWriter("b,now")
        self.fields: dict[tuple[str, ...], str] = {}

    def finish(self, code: str) -> Condition:
        if self._layout is not None and self.fields:
            # All named fields are read first, so `false && error` denies where one of them cannot be read.
            _FieldReader(self._source, self.fields).read(self._layout.root)
        self._source.line(f"return {code}")
        return self._source.compile(_ERRORS, "return False")

    def compile(self, node: Expression) -> tuple[str, str]:  # noqa: PLR0911 - one per node
        match node:
            case Literal(value):
                kind = {bool: "bool", int: "int", float: "double", str: "string"}[type(value)]
                return kind, self._source.bind(value)
            case Path(names):
                return self._path(names)
            case Now():
                return "timestamp", "now"
            case Unary():
                return self._unary(node)
            case MembershipTest():
                return self._membership(node)
            case Binary():
                return self._binary(node)
            case _ if node.target is None:
                return self._timestamp(node.name, node.arguments)
            case _:
                return self._method(node.target, node.name, node.arguments)

    def _path(self, names: tuple[str, ...]) -> tuple[str, str]:
        if self._layout is None:
            raise ConditionRefused("a condition on msg needs a message type", "name the type")
        kind = _field_type(self._layout.root, names)
        variable = self.fields.setdefault(names, f"v{len(self.fields)}")
        return kind, variable

    def _unary(self, node: Unary) -> tuple[str, str]:
        kind, code = self.compile(node.operand)
        if node.operator == "!" and kind == "bool":
            return "bool", f"(not {code})"
        if node.operator == "-" and kind in _NUMBERS:
            return kind, self._checked(kind, f"-{code}")
        raise ConditionRefused(f"{node.operator} cannot be applied to a {kind}")

    def _binary(self, node: Binary) -> tuple[str, str]:
        operator = node.operator
        left_kind, left = self.compile(node.left)
        right_kind, right = self.compile(node.right)
        if operator in ("&&", "||") and left_kind == right_kind == "bool":
            return "bool", f"({left} {'and' if operator == '&&' else 'or'} {right})"
        if operator in COMPARISONS and _comparable(left_kind, right_kind):
            return "bool", f"({left}{operator}{right})"
        if operator in "+-*" and left_kind == right_kind and left_kind in _NUMBERS:
            return left_kind, self._checked(left_kind, f"{left}{operator}{right}")
        mixed = {left_kind, right_kind} == set(_NUMBERS)
        raise ConditionRefused(
            f"{operator} cannot be applied to {left_kind} and {right_kind}",
            "write whole numbers as 2.0 beside a double" if mixed else "",
        )

    def _checked(self, kind: str, code: str) -> str:
        check = _in_64_bits if kind == "int" else _finite
        return f"{self._source.bind(check)}({code})"

    def _membership(self, node: MembershipTest) -> tuple[str, str]:
        kind, code = self.compile(node.operand)
        compiled = [self.compile(item) for item in node.items]
        for other, _ in compiled:
            if not _comparable(kind, other):
                raise ConditionRefused(f"in cannot compare {kind} with {other}")
        return "bool", f"({code} in ({''.join(f'{item},' for _, item in compiled)}))"

    def _timestamp(self, name: str, arguments: tuple[Expression, ...]) -> tuple[str, str]:
        match arguments:
            case (Literal(str() as text),) if name == "timestamp":
                return "timestamp", self._source.bind(parse_timestamp(text))
        raise ConditionRefused(f"unknown function {name}()", 'expected timestamp("2026-11-20T18:00:00Z")')

    def _method(self, target: Expression, name: str, arguments: tuple[Expression, ...]) -> tuple[str, str]:
        kind, code = self.compile(target)
        if kind == "timestamp" and name in FIELDS:
            match arguments:
                case ():
                    zone = "UTC"
                case (Literal(str() as zone),):
                    pass
                case _:
                    hint = 'for example now.getHours("Europe/Zurich")'
                    raise ConditionRefused("a time zone must be text", hint)
            return "int", f"{self._source.bind(clock_field(name, zone))}({code})"
        if kind == "string" and name in _METHODS and len(arguments) == 1:
            argument_kind, argument = self.compile(arguments[0])
            if argument_kind == "string":
                return "bool", f"{self._source.bind(_METHODS[name])}({code},{argument})"
        known = list(FIELDS if kind == "timestamp" else _METHODS if kind == "string" else ())
        raise ConditionRefused(
            f"a {kind} has no method {name}()", f"expected one of {', '.join(known)}" if known else ""
        )


class _FieldReader(Cursor):
    def __init__(self, source: SourceWriter, fields: dict[tuple[str, ...], str]) -> None:
        super().__init__(source)
        self._fields = fields
        self._left = len(fields)

    def read(self, root: Struct) -> None:
        self._struct(root, ())
        # A text may end beyond the message; numbers cannot, `unpack_from` checks.
        self.source.line(f"if len(b)<{self.at()}: raise ValueError")

    def _struct(self, kind: Struct, path: tuple[str, ...]) -> None:
        for name, member in kind.fields:
            if self._left == 0:
                return
            here = (*path, name)
            if here in self._fields:
                self._value(member, self._fields[here])
                self._left -= 1
            elif isinstance(member, Struct) and any(field[: len(here)] == here for field in self._fields):
                self._struct(member, here)
            else:
                self.skip(member)

    def _value(self, kind: Type, variable: str) -> None:
        start = self.position
        self.skip(kind)
        if not isinstance(kind, Primitive):
            content = f"b[{expression(start, 4)}:{self.at()}]"
            self.source.line(f"{variable}=str({content},'utf-8')")
            return
        read = self.source.bind(struct.Struct(f"<{kind.code}").unpack_from)
        self.source.line(f"{variable},={read}(b,{expression(start)})")
        if kind.name == "bool":
            self.source.line(f"{variable}={variable}!=0")
        elif kind.code in "fd":
            # NaN denies: implementations of CEL disagree on `!(x > 0.0)` for it, and ROS messages have it
            # routinely.
            self.source.line(f"if {variable}!={variable}: raise ValueError")


def _field_type(root: Struct, names: tuple[str, ...]) -> str:
    kind: Type = root
    for n, name in enumerate(names):
        members = dict(kind.fields) if isinstance(kind, Struct) else {}
        if name not in members:
            where = ".".join(("msg", *names[:n]))
            if isinstance(kind, Struct):
                raise ConditionRefused(f"{where}.{name}: {kind.explain_missing(name)}")
            raise ConditionRefused(f"{where} is a {kind.name} and has no fields")
        kind = members[name]
    if isinstance(kind, Text):
        return "string"
    # No time stamps, of two numbers: the publisher sets them, so a condition on one would be its own word.
    if not isinstance(kind, Primitive) or len(kind.code) > 1:
        raise ConditionRefused(
            f"msg.{'.'.join(names)} is a {kind.name}; only numbers, booleans, strings can be read",
            "name a field inside it" if isinstance(kind, Struct) else "",
        )
    return "bool" if kind.name == "bool" else "double" if kind.code in "fd" else "int"


def _comparable(left: str, right: str) -> bool:
    return left == right or (left in _NUMBERS and right in _NUMBERS)


def _in_64_bits(value: int) -> int:
    if not -(1 << 63) <= value < 1 << 63:
        raise OverflowError
    return value


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise OverflowError
    return value
