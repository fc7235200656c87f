"""Requests to the process that applies rules, and its answers. Pure.

A frame is a length (4 bytes, network byte order) and so many bytes of deterministic CBOR:
`[rules, metadata, [[kind, which], ...], thesis_defaults]` one way; without metadata the rules are
compiled only. The other way `[0, [result, ...]]` with `[0, text]` or `[code, message, hint]` for
each query, or `[code, message, hint]`. An answer is not trusted: a process that was taken over may
have written it.
"""

from dataclasses import dataclass
from typing import Final

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError
from rossec.errors import (
    MetadataRefused,
    NameUndefined,
    RossecError,
    RulesExceeded,
    RulesNotConfined,
    RulesRefused,
)
from rossec.naming.documents import MAX_INPUT
from rossec.naming.metadata import MAX_ENTRIES, MAX_WHICH, Kind

HEAD: Final = 4
MAX_REQUEST: Final = 2 * MAX_INPUT + (MAX_ENTRIES + 1) * (4 * MAX_WHICH + 16) + 64
MAX_ANSWER: Final = 1024 * 1024
READY: Final = b"\x00"  # the body of the first frame of a process, once it is confined
MAX_TEXT: Final = 1024  # characters of a name; legal ones have 255
_ERRORS: Final = (RulesRefused, MetadataRefused, NameUndefined, RulesExceeded, RulesNotConfined)
_ODD: Final = "the process that applies rules answers in another form"


@dataclass(frozen=True)
class NameRequest:
    """Rules, metadata, and what is asked; no metadata: compile the rules."""

    rules: bytes
    metadata: bytes
    queries: tuple[tuple[Kind, str], ...] = ()
    thesis_defaults: bool = False


Result = str | RossecError


def frame(body: bytes) -> bytes:
    """A body with its length in front."""
    return len(body).to_bytes(HEAD) + body


def size(head: bytes, limit: int) -> int:
    """The number of bytes after a frame's head.

    Raises:
        RulesExceeded: none, or more than `limit`.
    """
    found = int.from_bytes(head)
    if not 0 < found <= limit:
        raise RulesExceeded(f"{found} bytes where at most {limit} are allowed")
    return found


def write_request(request: NameRequest) -> bytes:
    """The body for `request`."""
    queries: list[Value] = [[kind.value, which] for kind, which in request.queries]
    return encode([request.rules, request.metadata, queries, request.thesis_defaults])


def read_request(body: bytes) -> NameRequest:
    """Read the body of a request.

    Raises:
        EncodingError: malformed, which the own side does not write.
    """
    match decode(body, limit=MAX_REQUEST):
        case [bytes() as rules, bytes() as metadata, list() as queries, bool() as thesis]:
            return NameRequest(rules, metadata, tuple(map(_query, queries)), thesis)
        case _:
            raise EncodingError("a request of another form")


def _query(item: Value) -> tuple[Kind, str]:
    match item:
        case [str() as kind, str() as which] if kind in set(Kind):
            return Kind(kind), which
        case _:
            raise EncodingError("a query of another form")


def write_names(results: list[Result]) -> bytes:
    """The body for the names of all queries."""
    return encode([0, [_written(result) for result in results]])


def write_error(error: RossecError) -> bytes:
    """The body for an error."""
    return encode(_written(error))


def _written(result: Result) -> Value:
    if isinstance(result, str):
        return [0, result]
    return [_ERRORS.index(type(result)) + 1, str(result)[:MAX_TEXT], result.hint[:MAX_TEXT]]


def read_names(body: bytes, count: int) -> list[Result]:
    """Read names, `count` of them; a refused one is its error.

    Raises:
        RossecError: what the process says instead, or it answers in another form.
    """
    items = _value(body)
    if not isinstance(items, list) or len(items) != count:
        raise RulesExceeded(_ODD)
    return [_result(item) for item in items]


def _value(body: bytes) -> Value:
    try:
        value = decode(body, limit=MAX_ANSWER)
    except EncodingError as error:
        raise RulesExceeded(_ODD) from error
    match value:
        case [0, found]:
            return found
        case _:
            raise _error(value)


def _result(item: Value) -> Result:
    match item:
        case [0, str() as text] if len(text) <= MAX_TEXT:
            return text
        case _:
            return _error(item)


def _error(item: Value) -> RossecError:
    match item:
        case [int() as code, str() as message, str() as hint] if 0 < code <= len(_ERRORS):
            return _ERRORS[code - 1](message[:MAX_TEXT], hint[:MAX_TEXT])
        case _:
            return RulesExceeded(_ODD)
