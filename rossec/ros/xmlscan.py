"""The fast path for an XML-RPC body: the plain form of nearly every call. Pure.

Plain means ASCII, no attributes, entities, comments or sections, and only the elements below, each
in its place. For anything else, errors included, `scan` returns None, and the XML parser decides.
So this module can only be faster than the parser, never more lenient: the tests compare the two.
"""

import binascii
import re
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

_PROLOG: Final = re.compile(
    r"(?:<\?xml version=(['\"])1\.0\1(?: encoding=(['\"])(?i:utf-8)\2)?\s?\?>\s*)?", re.ASCII
)
# The text excludes what has a meaning in XML ('<', '&', ']]>') and what XML forbids.
_TOKEN: Final = re.compile(r"<(/?[A-Za-z0-9]+)>([\t\n\r\x20-\x25\x27-\x3b\x3d-\x5c\x5e-\x7e]*)")
_TEXT: Final = r"[\t\n\x20-\x25\x27-\x3b\x3d-\x5c\x5e-\x7e]*"
# A call as rospy and roscpp send nearly all of theirs: scalar parameters only.
_FLAT: Final = re.compile(
    rf"(?:<\?xml version=(['\"])1\.0\1\?>[ \t\n]*)?<methodCall>[ \t\n]*"
    rf"<methodName>({_TEXT})</methodName>[ \t\n]*<params>[ \t\n]*"
    rf"((?:<param>[ \t\n]*<value>(?:<(string|int|i4|boolean|double)>{_TEXT}</\4>|{_TEXT})</value>"
    rf"[ \t\n]*</param>[ \t\n]*)*)</params>[ \t\n]*</methodCall>[ \t\n]*"
)
_FLAT_VALUE: Final = re.compile(rf"<value>(?:<([a-z0-9]+)>)?({_TEXT})<")
_INT: Final = re.compile(r"-?[0-9]{1,18}")
_TRUTH: Final = {"0": False, "1": True}

Tokens = Iterator[tuple[str, str]]


class Body(NamedTuple):
    """The parameters, the method where there is one, and the tag around it all."""

    params: tuple[object, ...]
    method: str | None
    root: str | None


class _NotPlainError(Exception):
    """Leave it to the XML parser."""


def scan(data: bytes, depth: int) -> Body | None:
    """The content of the body `data`; None: not plain, or nested deeper than `depth`."""
    try:
        text = data.decode("ascii")
        flat = _FLAT.fullmatch(text)
        if flat is not None:
            values = tuple([_SCALARS[kind](part) for kind, part in _FLAT_VALUE.findall(flat[3])])
            return Body(values, flat[2], "methodCall")
        prolog = _PROLOG.match(text)
        begin = 0 if prolog is None else prolog.end()
        pairs = _TOKEN.findall(text, begin)
        if begin + sum(len(tag) + len(rest) + 2 for tag, rest in pairs) != len(text):
            return None  # some text is not part of a token
        tokens = iter(pairs)
        body = _body(tokens, depth)
        return body if next(tokens, None) is None else None
    except (_NotPlainError, StopIteration, ValueError):
        return None


def _body(tokens: Tokens, depth: int) -> Body:
    root = _tag(tokens)
    method = None
    if root == "methodCall":
        tag, text = next(tokens)
        if tag != "methodName":
            raise _NotPlainError
        method = _string(text)
        _expect(tokens, "/methodName")
    elif root != "methodResponse":
        raise _NotPlainError
    _expect(tokens, "params")
    params: list[object] = []
    while (tag := _tag(tokens)) == "param":
        params.append(_value(tokens, depth))
        _expect(tokens, "/param")
    if tag != "/params":
        raise _NotPlainError
    _expect(tokens, f"/{root}")
    return Body(tuple(params), method, root)


def _value(tokens: Tokens, depth: int) -> object:
    tag, text = next(tokens)
    if tag != "value":
        raise _NotPlainError
    return _typed(tokens, text, depth)


def _typed(tokens: Tokens, outer: str, depth: int) -> object:
    """What follows `<value>`, with its end; `outer` is the text right behind that tag."""
    tag, text = next(tokens)
    if tag == "/value":  # no type: a string
        _check_blank(text)
        return _string(outer)
    _check_blank(outer)
    scalar = _SCALARS.get(tag)
    if scalar is not None:
        value = scalar(text)
        _expect(tokens, f"/{tag}")
    else:
        _check_blank(text)
        value = _tree(tokens, tag, depth - 1)
    _expect(tokens, "/value")
    return value


def _tree(tokens: Tokens, tag: str, depth: int) -> object:
    """An array or a struct, with its end."""
    if depth < 0:
        raise _NotPlainError
    if tag == "array":
        return _array(tokens, depth)
    if tag == "struct":
        return _struct(tokens, depth)
    raise _NotPlainError


def _array(tokens: Tokens, depth: int) -> list[object]:
    _expect(tokens, "data")
    values: list[object] = []
    while True:
        tag, text = next(tokens)
        if tag == "/data":
            _check_blank(text)
            _expect(tokens, "/array")
            return values
        if tag != "value":
            raise _NotPlainError
        values.append(_typed(tokens, text, depth))


def _struct(tokens: Tokens, depth: int) -> dict[str, object]:
    values: dict[str, object] = {}
    while (tag := _tag(tokens)) == "member":
        name, text = next(tokens)
        if name != "name":
            raise _NotPlainError
        key = _string(text)
        _expect(tokens, "/name")
        values[key] = _value(tokens, depth)
        _expect(tokens, "/member")
    if tag != "/struct":
        raise _NotPlainError
    return values


def _string(text: str) -> str:
    if "\r" in text:  # XML reads a line feed
        raise _NotPlainError
    return text


def _int(text: str) -> int:
    if _INT.fullmatch(text) is None:
        raise _NotPlainError
    return int(text)


def _boolean(text: str) -> bool:
    if text not in _TRUTH:
        raise _NotPlainError
    return _TRUTH[text]


_SCALARS: Final[dict[str, Callable[[str], object]]] = {
    "": _string,
    "string": _string,
    "int": _int,
    "i4": _int,
    "boolean": _boolean,
    "double": float,
    "base64": binascii.a2b_base64,
}


def _tag(tokens: Tokens) -> str:
    tag, text = next(tokens)
    _check_blank(text)
    return tag


def _expect(tokens: Tokens, wanted: str) -> None:
    tag, text = next(tokens)
    if tag != wanted or (text and not text.isspace()):
        raise _NotPlainError


def _check_blank(text: str) -> None:
    if text and not text.isspace():
        raise _NotPlainError
