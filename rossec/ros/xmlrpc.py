"""XML-RPC calls and responses as bytes, and ROS's `[code, status, value]` convention.

The standard library marshals. What it lacks is here: a size limit before the parse, no document
type and no entity (the billion-laughs bomb needs both), a bound on nesting (values are walked
recursively later), UTF-8 only, and one class of error for all failures.
Values are what XML-RPC has: bool, int, float, str, bytes, datetime, list, dict with str keys.
"""

import xmlrpc.client
from collections.abc import Generator, Sequence
from typing import Final, NamedTuple, NoReturn, TypeVar
from xml.parsers import expat

from rossec.errors import AnswerMalformed, AnswerRefused, XmlRpcRefused
from rossec.ros import xmlwrite
from rossec.ros.text import printable
from rossec.ros.xmlscan import Body, scan

Fault = xmlrpc.client.Fault
"""What a server answers when there is no value: `Fault(faultCode, faultString)`."""

FAULT_CODE: Final = 1  # the only one stock ROS uses
BODY_LIMIT: Final = 4 * 1024 * 1024  # as XML, some 30,000 parameters
STEP: Final = 16 * 1024  # bytes of XML that are parsed at a time: 1 to 4 ms
_MARKUP_LIMIT: Final = 64 * 1024  # of one tag or comment, which expat reads again with each step
DEPTH_LIMIT: Final = 40  # nested arrays and structs; stock parameter trees stay below ten
_TAGS_PER_LEVEL: Final = 3  # value, array, data; or value, struct, member
_TAGS_AROUND: Final = 6
METHOD_LIMIT: Final = 256
NOT_ENCODABLE: Final = (TypeError, OverflowError, ValueError, RecursionError)


class Call(NamedTuple):
    """A method name and its positional parameters."""

    method: str
    params: tuple[object, ...]


class Encoded(NamedTuple):
    """A response that is encoded already, or used as such: `dump_response` returns it as it is."""

    body: bytes


def dump_call(method: str, params: Sequence[object]) -> bytes:
    """The body of a request.

    Raises:
        XmlRpcRefused: a parameter cannot be carried (None, an integer beyond 32 bits, ...).
    """
    try:
        return xmlwrite.call(method, params).encode()
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error


def dump_response(value: object) -> bytes:
    """The body of a response that holds `value`, or a fault if `value` is one, or is `Encoded`.

    Raises:
        XmlRpcRefused: the value cannot be carried.
    """
    if isinstance(value, Encoded):
        return value.body
    try:
        if isinstance(value, Fault):
            return xmlrpc.client.dumps(value).encode()
        return xmlwrite.response(value).encode()
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error


def load_call(data: bytes, *, limit: int = BODY_LIMIT) -> Call:
    """The one call that fills `data`.

    Raises:
        XmlRpcRefused: too long, too deep, malformed, or not a call.
    """
    _check_size(data, limit)
    return _call_in(scan(data, DEPTH_LIMIT) or run_out(_parse(data)))


def call_steps(data: bytes, *, limit: int = BODY_LIMIT) -> Generator[None, None, Call]:
    """As `load_call`, in steps: it yields after each."""
    _check_size(data, limit)
    return _call_in((yield from _body_steps(data)))


def _call_in(body: Body) -> Call:
    params, method, root = body
    if root != "methodCall" or not isinstance(method, str) or not method:
        raise XmlRpcRefused("XML that is not an XML-RPC call")
    if len(method) > METHOD_LIMIT:
        raise XmlRpcRefused("a method name that is too long")
    return Call(method, params)


def load_response(data: bytes, *, limit: int = BODY_LIMIT) -> object:
    """The one value of a response.

    Raises:
        Fault: the server answered with a fault, whose text is made printable.
        XmlRpcRefused: too long, too deep, malformed, or not a response.
    """
    _check_size(data, limit)
    return _value_in(scan(data, DEPTH_LIMIT) or run_out(_parse(data)))


def response_steps(data: bytes, *, limit: int = BODY_LIMIT) -> Generator[None, None, object]:
    """As `load_response`, in steps: it yields after each."""
    _check_size(data, limit)
    return _value_in((yield from _body_steps(data)))


def _value_in(body: Body) -> object:
    params, _, root = body
    if root == _FAULT and isinstance(fault := params[0], Fault):
        code: object = fault.faultCode  # of any type, as the peer sent it
        raise Fault(code if isinstance(code, int) else 0, printable(fault.faultString)) from None
    if root != "methodResponse" or len(params) != 1:
        raise XmlRpcRefused("XML that is not an XML-RPC response")
    return params[0]


ResultT = TypeVar("ResultT")


def run_out(steps: Generator[None, None, ResultT]) -> ResultT:
    """The result of all steps, taken at once."""
    try:
        while True:
            next(steps)
    except StopIteration as end:
        result: ResultT = end.value
        return result


def value_of(answer: object) -> object:
    """The value in ROS's `[1, status, value]`.

    Raises:
        AnswerRefused: the code is not 1; the message is the status text, made printable.
        AnswerMalformed: anything but such a triple.
    """
    if not isinstance(answer, list | tuple) or len(answer) != 3:
        raise AnswerMalformed("an answer that is not [code, status, value]")
    code, status, value = answer
    if not isinstance(code, int) or isinstance(code, bool) or not isinstance(status, str):
        raise AnswerMalformed("an answer whose code or status has the wrong type")
    if code != 1:
        raise AnswerRefused(printable(status) or "refused without a reason", code=code)
    return value


def is_unknown_method(error: Exception) -> bool:
    """Whether a server answered that it has no such method.

    All faults have code 1. The text is that of the standard library's `SimpleXMLRPCDispatcher`,
    which stock ROS uses, and of rossec's own servers.
    """
    text = str(error.faultString) if isinstance(error, Fault) else ""
    return 'method "' in text and text.endswith('" is not supported')


def too_long(size: int, limit: int) -> Fault:
    """What is answered in place of a response that is longer than peers accept."""
    return Fault(
        FAULT_CODE,
        f"rossec: the answer has {size} bytes, at most {limit} are sent: ask for less at a time",
    )


def _check_size(data: bytes, limit: int) -> None:
    if len(data) > limit:
        raise XmlRpcRefused(f"{len(data)} bytes of XML where at most {limit} are allowed")


def _body_steps(data: bytes) -> Generator[None, None, Body]:
    """The content of `data`: what is short is scanned, which is quicker, but one step."""
    plain = scan(data, DEPTH_LIMIT) if len(data) <= STEP else None
    return plain or (yield from _parse(data))


def _parse(data: bytes) -> Generator[None, None, Body]:
    """The content, of a fault itself with the root `_FAULT`; yields after each `STEP` bytes."""
    if data.startswith((b"\xff", b"\xfe")):  # expat obeys a UTF-16 mark despite its encoding
        raise XmlRpcRefused("malformed XML-RPC: not UTF-8")
    target = _Target()
    parser = _parser(target)
    try:
        for end in range(STEP, len(data), STEP):
            parser.Parse(data[end - STEP : end], False)
            _check_markup(end - parser.CurrentByteIndex)
            yield
        parser.Parse(data[(len(data) - 1) // STEP * STEP :] if data else b"", True)
        return Body(target.close(), target.getmethodname(), target.root)
    except Fault as fault:
        return Body((fault,), None, _FAULT)
    except XmlRpcRefused:
        raise
    except _MALFORMED as error:
        raise XmlRpcRefused("malformed XML-RPC") from error


def _check_markup(unparsed: int) -> None:
    if unparsed > _MARKUP_LIMIT:
        raise XmlRpcRefused(f"a tag or comment of more than {_MARKUP_LIMIT} bytes")


_FAULT: Final = "fault"  # as root of a body, which no body has that was parsed
_MALFORMED: Final = (
    expat.ExpatError, xmlrpc.client.Error, ValueError, TypeError, LookupError,
    ArithmeticError,  # of decimal: the library reads <bigdecimal>
)  # fmt: skip


class _Target(xmlrpc.client.Unmarshaller):
    """The library's unmarshaller with a bound on depth; stores the root element."""

    def __init__(self) -> None:
        super().__init__(use_builtin_types=True)
        self.xml("", None)  # no encoding: the parser already returns text
        self.root: str | None = None
        self._depth = 0

    def start(self, tag: str, attrs: dict[str, str]) -> None:
        self._depth += 1
        self.root = self.root or tag
        if self._depth > DEPTH_LIMIT * _TAGS_PER_LEVEL + _TAGS_AROUND:
            raise XmlRpcRefused(f"XML-RPC values nested deeper than {DEPTH_LIMIT}")
        super().start(tag, attrs)

    def end(self, tag: str) -> None:
        self._depth -= 1
        super().end(tag)


def _parser(target: _Target) -> expat.XMLParserType:
    # The explicit encoding overrides the document's own.
    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = target.start
    parser.EndElementHandler = target.end
    parser.CharacterDataHandler = target.data
    parser.StartDoctypeDeclHandler = _refuse_declaration
    parser.EntityDeclHandler = _refuse_declaration
    parser.buffer_text = True
    return parser


def _refuse_declaration(*_: object) -> NoReturn:
    raise XmlRpcRefused("XML-RPC with a document type or an entity declaration")
