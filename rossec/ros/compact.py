"""Calls and answers as units of the compact form (docs/spec/compact.md), as bytes. Pure.

A unit is one deterministic CBOR array and fills what the channel delivers at once. The number of a
call, modulo 24, is in the call and in its answer. The shape of an answer says what it is: ROS's
code, status and value; any other value; a fault; or a body of XML-RPC as a program gave it.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Final

from ca.encoding import head
from rossec.errors import CompactRefused, XmlRpcRefused
from rossec.ros.compactread import MALFORMED, Reader
from rossec.ros.compactwrite import (
    ARRAY,
    DEPTH_LIMIT,
    ITEM_BYTES,
    NULL,
    UINT,
    Pieces,
    number,
    put,
    text,
)
from rossec.ros.methodnumbers import METHODS, NUMBERS
from rossec.ros.text import printable
from rossec.ros.xmlrpc import (
    BODY_LIMIT,
    METHOD_LIMIT,
    NOT_ENCODABLE,
    Call,
    Encoded,
    Fault,
    too_long,
)

TURNS: Final = 24  # calls are numbered modulo this: one byte
_CALL: Final = 0x52
_MARK: Final = head(UINT, _CALL)
_PARTS: Final = 3  # mark, number, method
_ARRAYS: Final = tuple(head(ARRAY, size) for size in range(24))
_METHODS: Final = {name: head(UINT, place) for name, place in NUMBERS.items()}
_TURNS: Final = tuple(head(UINT, turn) for turn in range(TURNS))
_MALFORMED: Final = "a unit that ends too early, or has a text that is not UTF-8"
UNPARSED: Final = "getBusStats"
"""The one method whose answer is passed on as a program gave it: roscpp's is malformed XML."""
_BEGINNINGS: Final = tuple(_MARK + turn for turn in _TURNS)
_TRIPLE, _FAULT, _VALUE = 4, 3, 2  # items of an answer; a raw body has three, too


def dump_call(turn: int, method: str, params: Sequence[object]) -> bytes:
    """The unit of a call.

    Raises:
        XmlRpcRefused: a parameter cannot be carried.
    """
    size = _PARTS + len(params)
    begin = _ARRAYS[size] if size < 24 else head(ARRAY, size)
    out = Pieces((begin, _MARK, _TURNS[turn]))
    try:
        known = _METHODS.get(method)
        out.append(text(method) if known is None else known)
        for param in params:
            put(param, out)
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error
    return b"".join(out)


def load_call(data: bytes, turn: int, *, limit: int = BODY_LIMIT) -> Call:
    """The call that fills `data`, which must have this number.

    Raises:
        CompactRefused: too long, malformed, of another number, or not a call.
    """
    reader = _reader(data, limit)
    try:
        if data[1:4] == _BEGINNINGS[turn] and 0x83 <= data[0] < 0x98 and data[4] < 24:
            size, method = data[0] - ARRAY, METHODS[data[4]]  # nearly every call begins so
            reader.at = 5
        else:
            size, method = _begin(reader, turn)
        params = tuple(reader.items(size - _PARTS))
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return Call(method, params)


def call_steps(data: bytes, turn: int, *, limit: int = BODY_LIMIT) -> Generator[None, None, Call]:
    """As `load_call`, in steps: it yields after each."""
    reader = _reader(data, limit)
    try:
        size, method = _begin(reader, turn)
        params = yield from reader.steps(size - _PARTS)
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return Call(method, (*params,))


def _begin(reader: Reader, turn: int) -> tuple[int, str]:
    """How many items a call has, and its method."""
    size = reader.head(ARRAY)
    if size < _PARTS or reader.head(UINT) != _CALL:
        raise CompactRefused("a unit that is not a call")
    _check_turn(reader, turn)
    return size, _method(reader)


def load_answer(data: bytes, turn: int, method: str, *, limit: int = BODY_LIMIT) -> object:
    """What the unit `data` answers to the call of this number: a value, a `Fault`, or `Encoded`.

    A fault is returned, not raised; its text is made printable.

    Raises:
        CompactRefused: too long, malformed, of another number, or not an answer to `method`.
    """
    reader = _reader(data, limit)
    try:
        count, depth, value_of = _shape(reader, turn)
        value = value_of(reader.items(count, depth), method)
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return value


def answer_steps(
    data: bytes, turn: int, method: str, *, limit: int = BODY_LIMIT
) -> Generator[None, None, object]:
    """As `load_answer`, in steps: it yields after each."""
    reader = _reader(data, limit)
    try:
        count, depth, value_of = _shape(reader, turn)
        value = value_of((yield from reader.steps(count, depth)), method)
    except MALFORMED as error:
        raise CompactRefused(_MALFORMED) from error
    _check_end(reader)
    return value


def _shape(reader: Reader, turn: int) -> "_Shape":
    """What follows the number of an answer."""
    size = reader.head(ARRAY)
    _check_turn(reader, turn)
    shape = _SHAPES.get(size)
    if shape is None:
        raise CompactRefused("a unit that is not an answer")
    return _RAW if size == _FAULT and reader.skip(NULL) else shape


def dump_answer(turn: int, value: object, *, limit: int = BODY_LIMIT) -> bytes:
    """The unit that answers the call of this number with a value, a `Fault` or what is `Encoded`.

    Raises:
        XmlRpcRefused: the value cannot be carried.
        Fault: it is longer than peers accept.
    """
    out = Pieces((b"", _TURNS[turn]))
    try:
        out[0] = _put_answer(value, out)
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error
    unit = b"".join(out)
    if len(unit) > limit or out.values > limit // ITEM_BYTES:
        raise too_long(len(unit), limit)
    return unit


def _put_answer(value: object, out: Pieces) -> bytes:
    """Append the items after the number; returns the head of the array they are in."""
    if isinstance(value, Fault):
        out += number(value.faultCode), text(value.faultString)
        return _ARRAYS[_FAULT]
    if isinstance(value, Encoded):
        out.append(NULL)
        put(value.body, out)
        return _ARRAYS[_FAULT]
    if isinstance(value, list | tuple) and _is_triple(value):
        out += number(value[0]), text(value[1])
        put(value[2], out, DEPTH_LIMIT - 1)
        return _ARRAYS[_TRIPLE]
    put(value, out)
    return _ARRAYS[_VALUE]


def _is_triple(value: Sequence[object]) -> bool:
    """Whether this is ROS's code, status and value, which have a shape of their own."""
    return len(value) == 3 and type(value[0]) is int and type(value[1]) is str


def _triple_in(found: list[object], _method: str) -> object:
    if not _is_triple(found):
        raise CompactRefused("an answer whose code or status has the wrong type")
    return found


def _raw_in(found: list[object], method: str) -> object:
    (body,) = found
    if not isinstance(body, bytes) or method != UNPARSED:
        raise CompactRefused(f"a body of XML-RPC in the answer to {printable(method)}")
    return Encoded(body)


def _fault_in(found: list[object], _method: str) -> object:
    code, reason = found
    if type(code) is not int or not isinstance(reason, str):
        raise CompactRefused("a fault whose code or text has the wrong type")
    return Fault(code, printable(reason))


def _value_in(found: list[object], _method: str) -> object:
    (value,) = found
    if isinstance(value, list) and _is_triple(value):
        raise CompactRefused("an answer whose code and status are inside its value")
    return value


_Shape = tuple[int, int, Callable[[list[object], str], object]]
"""How many items an answer has, how deep they are nested, and what is made of them."""

_RAW: Final[_Shape] = (1, DEPTH_LIMIT, _raw_in)
_SHAPES: Final[dict[int, _Shape]] = {
    _TRIPLE: (3, DEPTH_LIMIT - 1, _triple_in),
    _FAULT: (2, DEPTH_LIMIT, _fault_in),
    _VALUE: (1, DEPTH_LIMIT, _value_in),
}


def _reader(data: bytes, limit: int) -> Reader:
    if len(data) > limit:
        raise CompactRefused(f"a unit of {len(data)} bytes where at most {limit} are allowed")
    return Reader(data, limit)


def _check_turn(reader: Reader, turn: int) -> None:
    if reader.head(UINT) != turn:
        raise CompactRefused("a unit out of its turn")


def _check_end(reader: Reader) -> None:
    if not reader.at_end:
        raise CompactRefused("a unit with bytes after its end, or without some before")


def _method(reader: Reader) -> str:
    (method,) = reader.items(1)
    if type(method) is int and 0 <= method < len(METHODS):
        return METHODS[method]
    if not isinstance(method, str) or not 0 < len(method) <= METHOD_LIMIT or method in NUMBERS:
        raise CompactRefused("a call of a method that has no such number or name")
    return method
