"""XML-RPC calls and responses, encoded as by the standard library, but faster. Pure.

The text is exactly the library's: the tests compare the two. Rare types (doubles, times, structs,
base64) are left to the library itself.
"""

import xmlrpc.client
from collections.abc import Iterable
from typing import Final

_PROLOG: Final = "<?xml version='1.0'?>\n"
_BEGIN: Final = f"{_PROLOG}<methodResponse>\n<params>\n<param>\n"
_END: Final = "</param>\n</params>\n</methodResponse>\n"
_ONE: Final = len("<params>\n<param>\n"), -len("</param>\n</params>\n")
_INTS: Final = range(-(2**31), 2**31)


class EncodedList(list[object]):
    """A list that keeps its encodings; it must not change any more.

    Attributes:
        compact: the other form's encoding, if it was made, of `pieces` values
            (`rossec.ros.compactwrite`).
    """

    __slots__ = ("_text", "compact", "pieces")

    def __init__(self, items: list[object]) -> None:
        super().__init__(items)
        self._text: str | None = None
        self.compact: bytes | None = None
        self.pieces = 0

    @property
    def text(self) -> str:
        """The value element."""
        if self._text is None:
            self._text = _array(self)
        return self._text


def call(method: str, params: Iterable[object]) -> str:
    """The body of a request; `method` as it is.

    Raises:
        TypeError, OverflowError, RecursionError: a parameter cannot be encoded.
    """
    written = "".join([f"<param>\n{_value(param)}</param>\n" for param in params])
    head = f"{_PROLOG}<methodCall>\n<methodName>{method}</methodName>\n"
    return f"{head}<params>\n{written}</params>\n</methodCall>\n"


def response(value: object) -> str:
    """The body of a response that holds `value`.

    Raises:
        TypeError, OverflowError, RecursionError: the value cannot be encoded.
    """
    return f"{_BEGIN}{_value(value)}{_END}"


def _value(value: object) -> str:
    kind = type(value)
    if kind is str:
        return string(value)  # type: ignore[arg-type]
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


def string(text: str) -> str:
    """The text of a string value."""
    if "&" in text or "<" in text or ">" in text:
        text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return f"<value><string>{text}</string></value>\n"
