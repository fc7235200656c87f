"""XML-RPC calls and responses as bytes, and ROS's `[code, status, value]` convention. Pure.

The standard library marshals. What it lacks is here: a size limit before the parse, no document
type and no entity (the billion-laughs bomb needs both), a bound on nesting (values are walked
recursively later), UTF-8 only, and one class of error for all failures. Values are what XML-RPC has:
bool, int, float, str, bytes, datetime, list, dict with str keys. The usual ones are written and read
without the library, which is slower; the tests compare the two.
"""

import re
import xmlrpc
import xmlrpc.client
from collections.abc import Callable, Generator, Sequence
from typing import Final, NamedTuple, NoReturn, TypeVar
from xml.parsers import expat

from rossec.errors import AnswerMalformed, AnswerRefused, XmlRpcRefused
from rossec.peer_limits import printable

Fault = xmlrpc.client.Fault  # What a server answers when there is no value: `Fault(faultCode, faultString)`

FAULT_CODE: Final = 1  # the only one stock ROS uses
BODY_LIMIT: Final = 4 * 1024 * 1024  # as XML, some 30,000 parameters
STEP: Final = 16 * 1024  # bytes of XML that are parsed at a time: 1 to 4 ms
_MARKUP_LIMIT: Final = 64 * 1024  # of one tag or comment, which expat reads again with each step
DEPTH_LIMIT: Final = 40  # nested arrays and structs; stock parameter trees stay below ten
_TAGS_PER_LEVEL: Final = 3  # value, array, data; or value, struct, member
_TAGS_AROUND: Final = 6
METHOD_LIMIT: Final = 256
NOT_ENCODABLE: Final = (TypeError, OverflowError, ValueError, RecursionError)
ResultT = TypeVar("ResultT")
_PROLOG: Final = "<?xml version='1.0'?>\n"
_BEGIN: Final = f"{_PROLOG}<methodResponse>\n<params>\n<param>\n"
_END: Final = "</param>\n</params>\n</methodResponse>\n"
_ONE: Final = len("<params>\n<param>\n"), -len("</param>\n</params>\n")
_INTS: Final = range(-(2**31), 2**31)
# Without what has a meaning in XML ('<', '&', ']]>'), what XML forbids, and CR, which it reads as LF.
_TEXT: Final = r"[\t\n\x20-\x25\x27-\x3b\x3d-\x5c\x5e-\x7e]*"
_GAP: Final = r"[ \t\r\n]*"  # roscpp ends lines by CR LF
_FLAT: Final = re.compile(
    rf"(?:<\?xml version=(['\"])1\.0\1\?>{_GAP})?<methodCall>{_GAP}"
    rf"<methodName>({_TEXT})</methodName>{_GAP}<params>{_GAP}"
    rf"((?:<param>{_GAP}<value>(?:<(string|int|i4|boolean|double)>{_TEXT}</\4>|{_TEXT})</value>"
    rf"{_GAP}</param>{_GAP})*)</params>{_GAP}</methodCall>{_GAP}"
)
_FLAT_VALUE: Final = re.compile(rf"<value>(?:<([a-z0-9]+)>)?({_TEXT})<")
_INT: Final = re.compile(r"-?[0-9]{1,18}")


class Call(NamedTuple):
    """A method name and its positional parameters."""

    method: str
    params: tuple[object, ...]


class Encoded(NamedTuple):
    """A response that is encoded already, or used as such: `dump_response` returns it as it is."""

    body: bytes


class EncodedList(list[object]):
    """A list that keeps its encodings; it must not change any more."""

    __slots__ = ("_text", "compact", "pieces")

    def __init__(self, items: list[object]) -> None:
        super().__init__(items)
        self._text: str | None = None
        # the other form's encoding, if it was made, of `pieces` values (`rossec.ros.compact_values`)
        self.compact: bytes | None = None
        self.pieces = 0

    @property
    def text(self) -> str:
        """The value element."""
        if self._text is None:
            self._text = _array(self)
        return self._text


class Body(NamedTuple):
    params: tuple[object, ...]
    method: str | None
    root: str | None


def dump_call(method: str, params: Sequence[object]) -> bytes:
    try:
        written = "".join([f"<param>\n{_value(param)}</param>\n" for param in params])
        head = f"{_PROLOG}<methodCall>\n<methodName>{method}</methodName>\n"
        return f"{head}<params>\n{written}</params>\n</methodCall>\n".encode()
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error


def dump_response(value: object) -> bytes:
    if isinstance(value, Encoded):
        return value.body
    try:
        if isinstance(value, Fault):
            return xmlrpc.client.dumps(value).encode()
        return f"{_BEGIN}{_value(value)}{_END}".encode()
    except NOT_ENCODABLE as error:
        raise XmlRpcRefused(f"a value that XML-RPC cannot carry: {error}") from error


def load_call(data: bytes, *, limit: int = BODY_LIMIT) -> Call:
    _check_size(data, limit)
    return _call_in(scan(data) or run_out(_parse(data)))


def call_steps(data: bytes, *, limit: int = BODY_LIMIT) -> Generator[None, None, Call]:
    _check_size(data, limit)
    flat = scan(data) if len(data) <= STEP else None
    return _call_in(flat or (yield from _parse(data)))


def _call_in(body: Body) -> Call:
    params, method, root = body
    if root != "methodCall" or not isinstance(method, str) or not method:
        raise XmlRpcRefused("XML that is not an XML-RPC call")
    if len(method) > METHOD_LIMIT:
        raise XmlRpcRefused("a method name that is too long")
    return Call(method, params)


def load_response(data: bytes, *, limit: int = BODY_LIMIT) -> object:
    _check_size(data, limit)
    return _value_in(run_out(_parse(data)))


def response_steps(data: bytes, *, limit: int = BODY_LIMIT) -> Generator[None, None, object]:
    _check_size(data, limit)
    return _value_in((yield from _parse(data)))


def _value_in(body: Body) -> object:
    params, _, root = body
    if root == _FAULT and isinstance(fault := params[0], Fault):
        code: object = fault.faultCode  # of any type, as the peer sent it
        raise Fault(code if isinstance(code, int) else 0, printable(fault.faultString)) from None
    if root != "methodResponse" or len(params) != 1:
        raise XmlRpcRefused("XML that is not an XML-RPC response")
    return params[0]


def run_out(steps: Generator[None, None, ResultT]) -> ResultT:
    try:
        while True:
            next(steps)
    except StopIteration as end:
        result: ResultT = end.value
        return result


def value_of(answer: object) -> object:
    if not isinstance(answer, list | tuple) or len(answer) != 3:
        raise AnswerMalformed("an answer that is not [code, status, value]")
    code, status, value = answer
    if not isinstance(code, int) or isinstance(code, bool) or not isinstance(status, str):
        raise AnswerMalformed("an answer whose code or status has the wrong type")
    if code != 1:
        raise AnswerRefused(printable(status) or "refused without a reason", code=code)
    return value


def is_unknown_method(error: Exception) -> bool:
    # Whether a server answered that it has no such method. All faults have code 1. The text is that of the
    # standard library's `SimpleXMLRPCDispatcher`, which stock ROS uses, and of rossec's own servers.
    text = str(error.faultString) if isinstance(error, Fault) else ""
    return 'method "' in text and text.endswith('" is not supported')


def too_long(size: int, limit: int) -> Fault:
    return Fault(
        FAULT_CODE, f"rossec: the answer has {size} bytes, at most {limit} are sent: ask for less at a time"
    )


def _check_size(data: bytes, limit: int) -> None:
    if len(data) > limit:
        raise XmlRpcRefused(f"{len(data)} bytes of XML where at most {limit} are allowed")


# Written exactly as the library does it; rare types (doubles, times, structs, base64) are left to it.


def _value(value: object) -> str:
    kind = type(value)
    if kind is str:
        text: str = value  # type: ignore[assignment]
        if "&" in text or "<" in text or ">" in text:
            text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        return f"<value><string>{text}</string></value>\n"
    if kind is int and value in _INTS:
        return f"<value><int>{value}</int></value>\n"
    if kind is EncodedList:
        return value.text  # type: ignore[attr-defined,no-any-return]
    if kind is list or kind is tuple:
        return _array(value)  # type: ignore[arg-type]
    begin, end = _ONE
    return xmlrpc.client.dumps((value,))[begin:end]  # type: ignore[arg-type]


def _array(items: "list[object] | tuple[object, ...]") -> str:
    return f"<value><array><data>\n{''.join(map(_value, items))}</data></array></value>\n"


# The fast path: a call of scalars in plain ASCII, as rospy and roscpp send nearly all of theirs, by one
# regular expression. It takes a third of the parser's time, which was the largest part of a call's
# (docs/decisions/0045-compact-calls.md). All else, errors included, is left to the parser: this can only
# be faster, never more lenient.
def scan(data: bytes) -> Body | None:
    try:
        flat = _FLAT.fullmatch(data.decode("ascii"))
        if flat is None:
            return None
        values = tuple([_SCALARS[kind](part) for kind, part in _FLAT_VALUE.findall(flat[3])])
    except (ValueError, KeyError):
        return None
    return Body(values, flat[2], "methodCall")


def _int(text: str) -> int:
    if _INT.fullmatch(text) is None:
        raise ValueError(text)
    return int(text)


_SCALARS: Final[dict[str, Callable[[str], object]]] = {
    "": str,
    "string": str,
    "int": _int,
    "i4": _int,
    "boolean": {"0": False, "1": True}.__getitem__,
    "double": float,
}


def _parse(data: bytes) -> Generator[None, None, Body]:
    if data.startswith((b"\xff", b"\xfe")):  # expat obeys a UTF-16 mark despite its encoding
        raise XmlRpcRefused("malformed XML-RPC: not UTF-8")
    target = _Target()
    parser = expat.ParserCreate("utf-8")  # overrides the document's own
    parser.StartElementHandler = target.start
    parser.EndElementHandler = target.end
    parser.CharacterDataHandler = target.data
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = _refuse_declaration
    parser.buffer_text = True
    try:
        for end in range(STEP, len(data), STEP):
            parser.Parse(data[end - STEP : end], False)
            unparsed = end - parser.CurrentByteIndex
            if unparsed > _MARKUP_LIMIT:
                raise XmlRpcRefused(f"a tag or comment of more than {_MARKUP_LIMIT} bytes")
            yield
        parser.Parse(data[(len(data) - 1) // STEP * STEP :] if data else b"", True)
        return Body(target.close(), target.getmethodname(), target.root)
    except Fault as fault:
        return Body((fault,), None, _FAULT)
    except XmlRpcRefused:
        raise
    except _MALFORMED as error:
        raise XmlRpcRefused("malformed XML-RPC") from error


_FAULT: Final = "fault"  # as root of a body, which no body has that was parsed
# ArithmeticError is of decimal: the library reads <bigdecimal>.
_MALFORMED: Final = (
    expat.ExpatError,
    xmlrpc.client.Error,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
)


class _Target(xmlrpc.client.Unmarshaller):
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


def _refuse_declaration(*_: object) -> NoReturn:
    # Entities that expand to entities: a kilobyte of XML becomes gigabytes (billion laughs).
    raise XmlRpcRefused("XML-RPC with a document type or an entity declaration")
