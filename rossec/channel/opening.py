"""The first bytes of a connection, valid for a plain ROS peer, and the answer to such a peer.

The initiator's opening is a TCPROS connection header with the one field `rossec=1`, or an HTTP request that
asks to upgrade; neither holds anything private. A plain peer answers either readably instead of waiting for a
bogus length. Conversely, a plain caller gets the refusal in its own protocol. No channel state: functions
from a prefix of the stream to a verdict, which is `None` while the prefix is too short. At the end, the
post-quantum policy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeAlias

from rossec.channel.edhoc.messages import printable
from rossec.channel.edhoc.suites import POST_QUANTUM
from rossec.errors import ConfigurationError, PlainPeer, ProtocolViolation

MAX_OPENING: Final = 4 * 1024
MAX_DRAIN: Final = 1024 * 1024
"""How much of a plain caller's request is read and discarded, so that it receives the answer."""

_VERSION: Final = b"rossec=1"
_FIELD: Final = len(_VERSION).to_bytes(4, "little") + _VERSION
_TCPROS: Final = len(_FIELD).to_bytes(4, "little") + _FIELD
_REQUEST: Final = b"GET /rossec HTTP/1.1\r\nHost: rossec\r\nConnection: Upgrade\r\nUpgrade: rossec/1\r\n\r\n"
_SWITCH: Final = b"HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: rossec/1\r\n\r\n"
_METHODS: Final = (b"GET ", b"POST", b"HEAD", b"PUT ", b"OPTI")

REFUSAL: Final = (
    "rossec: this node accepts only connections secured by rossec; "
    "enroll your program as a node (see the README of rossec)"
)
VARIABLE: Final = "ROSSEC_POST_QUANTUM"
DEFAULT: Final = "off"
_ONE_OF: Final = f"one of: {', '.join(POST_QUANTUM)}"
HINT_PLAIN: Final = "the peer is a plain ROS node: give it an identity, or use another address"


class WireProtocol(Enum):
    TCPROS = "tcpros"
    HTTP = "http"


@dataclass(frozen=True)
class Accepted:
    """The peer speaks rossec: drop `consumed` bytes, send `reply`, begin the handshake."""

    protocol: WireProtocol
    consumed: int
    reply: bytes


@dataclass(frozen=True)
class PlainCaller:
    """The peer is a plain one: drop `drain` bytes, send `refusal(protocol)`, close."""

    protocol: WireProtocol
    drain: int


Verdict: TypeAlias = Accepted | PlainCaller | None


def first_bytes(protocol: WireProtocol) -> bytes:
    return _TCPROS if protocol is WireProtocol.TCPROS else _REQUEST


def classify_caller(data: bytes) -> Verdict:
    """Classify what a caller sent so far (at least its first bytes, at most `MAX_OPENING` matter)."""
    if len(data) < 4:
        return None
    if data[:4] in _METHODS:
        return _classify_http(data)
    length = int.from_bytes(data[:4], "little")
    if length == len(_FIELD):
        if len(data) < len(_TCPROS):
            return None
        if data[: len(_TCPROS)] == _TCPROS:
            return Accepted(WireProtocol.TCPROS, len(_TCPROS), b"")
    # A real header holds the message definition, some kilobytes; a field needs 5 bytes (N7).
    if not 5 <= length <= MAX_DRAIN:
        raise ProtocolViolation("the first bytes are neither ROS nor rossec")
    return PlainCaller(WireProtocol.TCPROS, 4 + length)


def _classify_http(data: bytes) -> Verdict:
    end = data.find(b"\r\n\r\n", 0, MAX_OPENING)
    if end < 0:
        if len(data) >= MAX_OPENING:
            raise ProtocolViolation("an HTTP request head beyond the limit")
        return None
    lines = data[:end].split(b"\r\n")
    fields: dict[bytes, bytes] = {}
    for line in lines[1:]:
        name, colon, value = line.partition(b":")
        if not colon or name.lower() in fields:
            raise ProtocolViolation("a malformed HTTP request head")
        fields[name.lower()] = value.strip()
    if lines[0] == b"GET /rossec HTTP/1.1" and fields.get(b"upgrade") == b"rossec/1":
        return Accepted(WireProtocol.HTTP, end + 4, _SWITCH)
    text = fields.get(b"content-length", b"0")
    body = min(int(text), MAX_DRAIN) if text.isdigit() and len(text) <= 9 else 0
    return PlainCaller(WireProtocol.HTTP, end + 4 + body)


def refusal(protocol: WireProtocol) -> bytes:
    return tcpros_refusal(REFUSAL) if protocol is WireProtocol.TCPROS else http_refusal(REFUSAL)


def tcpros_refusal(text: str) -> bytes:
    field = b"error=" + text.encode()
    body = len(field).to_bytes(4, "little") + field
    return len(body).to_bytes(4, "little") + body


def http_refusal(text: str) -> bytes:
    escaped = text.replace("&", "&amp;").replace("<", "&lt;")
    body = (
        "<?xml version='1.0'?>\n<methodResponse><params><param><value><array><data>"
        "<value><int>-1</int></value>"
        f"<value><string>{escaped}</string></value>"
        "<value><int>0</int></value>"
        "</data></array></value></param></params></methodResponse>\n"
    ).encode()
    head = (
        "HTTP/1.1 200 OK\r\nServer: rossec\r\nContent-Type: text/xml\r\n"
        f"Content-length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body


def classify_answer(data: bytes, protocol: WireProtocol) -> int | None:
    """Classify the answer to `first_bytes`: how many bytes precede the first frame.

    A TCPROS answer has no preamble. A handshake frame cannot be mistaken for a TCPROS header:
    the low half of its length is never zero, while that half of a header's (little endian) is.
    """
    if len(data) < 4:
        return None
    if data[:4] == b"HTTP":
        end = data.find(b"\r\n\r\n", 0, MAX_OPENING)
        if end < 0 and len(data) < MAX_OPENING:
            return None
        if protocol is WireProtocol.HTTP and data[: len(_SWITCH)] == _SWITCH:
            return len(_SWITCH)
        status = printable(data.split(b"\r\n", 1)[0].decode("latin-1"))
        raise PlainPeer(f"the peer is a plain HTTP server and says: {status}", HINT_PLAIN)
    if data[2:4] == b"\0\0":
        length = 4 + int.from_bytes(data[:4], "little")
        wanted = min(length, MAX_OPENING)
        if len(data) < wanted:
            return None
        said, body = "answers without an error", data[4:wanted]
        while len(body) >= 4:
            length = int.from_bytes(body[:4], "little")
            name, _, value = body[4 : 4 + length].partition(b"=")
            if name == b"error":
                said = f"says: {printable(value.decode(errors='replace'))}"
                break
            body = body[4 + length :]
        raise PlainPeer(f"the peer is a plain ROS node and {said}", HINT_PLAIN)
    if protocol is WireProtocol.HTTP:
        raise PlainPeer("the peer does not answer in HTTP", HINT_PLAIN)
    return 0


def post_quantum(environ: Mapping[str, str], option: str | None = None) -> tuple[int, ...]:
    """The suites to offer and accept, in order of preference, as an operator writes it; an option wins.

    `off` means the classical suite alone, `prefer` the hybrid one with peers that support it, `require` the
    hybrid one alone. Any other value refuses the program's start: a misspelt `require` must not give less.
    """
    where, word = VARIABLE, environ.get(VARIABLE, DEFAULT)
    if option is not None:
        where, word = "the post-quantum policy", option
    suites = POST_QUANTUM.get(word)
    if suites is None:
        import difflib  # noqa: PLC0415 - for mistakes alone

        near = difflib.get_close_matches(word.strip().lower(), POST_QUANTUM, 1, 0.5)
        hint = f"did you mean {near[0]}? {_ONE_OF}" if near else _ONE_OF
        raise ConfigurationError(f"{where} is {word!r}", hint)
    return suites
