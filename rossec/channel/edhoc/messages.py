"""The messages of EDHOC (RFC 9528 section 5 and 6) to bytes and back.

Structure only: no keys, no policy, no state. Decoding is strict, and since `ca.encoding` accepts only the one
deterministic form, hashing `encode(item)` is the same as hashing the bytes that were received.
"""

from typing import Final, NamedTuple

from ca.encoding import Value, decode_sequence, encode
from ca.errors import EncodingError
from rossec.channel.edhoc.credentials import X5CHAIN, X5CHAIN_HEAD, encode_id_cred
from rossec.channel.edhoc.suites import SIGNATURE_LENGTH, bstr
from rossec.errors import HandshakeFailed

MAX_MESSAGE_1: Final = 1024 + 1216  # leaves room for a hybrid G_X
MAX_MESSAGE: Final = 16 * 1024
MAX_PLAINTEXT_2: Final = 255 * 32  # what HKDF-Expand can pad (RFC 9528 section 5.3.2)
MAX_SUITES: Final = 16
MAX_REASON: Final = 200

_HEADS: Final = {b"\x58": 2, b"\x59": 3}  # of byte strings that are not shorter than 24
_SIGNATURE_HEAD: Final = b"\x58\x40"  # a byte string of 64 bytes
_NEGATIVE: Final = 0x20  # major type 1

RENEWALS: Final = 32768
"""EAD label (private use, RFC 9528 section 10.5): "take what is renewed on the open connection"."""
RENEWALS_EAD: Final = encode(RENEWALS)

UNSPECIFIED: Final = 1  # ERR_CODE, RFC 9528 section 6
WRONG_SUITE: Final = 2
UNKNOWN_CREDENTIAL: Final = 3


class Message1(NamedTuple):
    method: int
    suites: tuple[int, ...]
    g_x: bytes
    c_i: bytes

    def encode(self) -> bytes:
        method, suites = encode(self.method), encode(suites_item(self.suites))
        return method + suites + bstr(self.g_x) + encode_identifier(self.c_i)


class Plaintext(NamedTuple):
    """PLAINTEXT_2 and PLAINTEXT_3; `c_r` is None in the latter."""

    c_r: bytes | None
    id_cred: Value
    signature: bytes
    ead: bytes = b""

    def encode(self) -> bytes:
        c_r = b"" if self.c_r is None else encode_identifier(self.c_r)
        return c_r + encode_id_cred(self.id_cred) + bstr(self.signature) + self.ead


def suites_item(suites: tuple[int, ...]) -> Value:
    """One suite alone is an integer, never an array."""
    return list(suites) if len(suites) > 1 else suites[0]


def encode_identifier(value: bytes) -> bytes:
    """bstr_identifier (RFC 9528 section 3.3.2): a small CBOR integer stands alone."""
    return value if _is_small_int(value) else encode(value)


def decode_message_1(data: bytes) -> Message1:
    usual = _usual_message_1(data)
    if usual is not None:
        return usual
    match _sequence(data, MAX_MESSAGE_1):
        case [int() as method, suites, bytes() as g_x, c_i, *ead] if not isinstance(method, bool):
            _check_ead(ead)
            return Message1(method, _decode_suites(suites), g_x, _decode_identifier(c_i))
        case _:
            raise HandshakeFailed("malformed message_1")


def decode_bytes(data: bytes) -> bytes:
    """Decode message_2, message_3 or message_4: one byte string."""
    body = _body(data)
    if len(data) > MAX_MESSAGE or bstr(body) != data:
        raise HandshakeFailed("a handshake message is not one byte string")
    return body


def decode_plaintext(data: bytes, *, with_c_r: bool) -> Plaintext:
    start = 1 if with_c_r else 0
    usual = _usual_plaintext(data, start, RENEWALS_EAD) or _usual_plaintext(data, start, b"")
    if usual is not None:
        return usual
    items = _sequence(data, MAX_MESSAGE)
    c_r = _decode_identifier(items.pop(0)) if with_c_r and items else None
    match items:
        case [dict() as id_cred, bytes() as signature, *ead] if len(signature) == SIGNATURE_LENGTH:
            # `kid` (label 4) and its compact forms name raw keys, which are no identity here.
            return Plaintext(c_r, id_cred, signature, _check_ead(ead))
        case _:
            raise HandshakeFailed("malformed plaintext in a handshake message")


def says_renewals(ead: bytes) -> bool:
    return ead == RENEWALS_EAD or (bool(ead) and RENEWALS in _sequence(ead, MAX_MESSAGE))


def decode_plaintext_4(data: bytes) -> None:
    if data:
        _check_ead(_sequence(data, MAX_MESSAGE))


def encode_error(code: int, info: Value) -> bytes:
    return encode(code) + encode(info)


def decode_error(data: bytes) -> tuple[int, str, tuple[int, ...]]:
    """Decode an error message: its code, a printable reason, and SUITES_R (for code 2)."""
    match _sequence(data, 1024):
        case [2, suites]:
            return WRONG_SUITE, "no common cipher suite", _decode_suites(suites)
        case [3, True]:
            return UNKNOWN_CREDENTIAL, "it does not know the credential this node named", ()
        case [1, str() as text]:
            return UNSPECIFIED, printable(text), ()
        case _:
            raise HandshakeFailed("malformed error message")


def printable(text: str) -> str:
    """An unauthenticated peer's text made fit for a log: one line, printable, bounded."""
    kept = "".join(c if c.isprintable() else " " for c in text[:MAX_REASON])
    return " ".join(kept.split())


# Nearly every message has the same structure, and a structure has one allowed encoding: comparing
# takes a tenth of the time of decoding. A message that differs in any bit is decoded in full.


def _usual_message_1(data: bytes) -> Message1 | None:
    item = data[2:-1]
    g_x, ends = _body(item), (data[0:1], data[1:2], data[-1:])
    if len(data) > MAX_MESSAGE_1 or bstr(g_x) != item or not all(map(_is_small_int, ends)):
        return None
    return Message1(_small_int(data[0]), (_small_int(data[1]),), g_x, ends[2])


def _usual_plaintext(data: bytes, start: int, ead: bytes) -> Plaintext | None:
    end = len(data) - SIGNATURE_LENGTH - len(ead)
    item = data[start + len(X5CHAIN_HEAD) : end - len(_SIGNATURE_HEAD)]
    certificate = _body(item)
    if (
        len(data) > MAX_MESSAGE
        or not data.endswith(ead)
        or not data.startswith(X5CHAIN_HEAD, start)
        or not data.startswith(_SIGNATURE_HEAD, end - len(_SIGNATURE_HEAD))
        or bstr(certificate) != item
        or (start > 0 and not _is_small_int(data[:start]))
    ):
        return None
    signature = data[end : end + SIGNATURE_LENGTH]
    return Plaintext(data[:start] or None, {X5CHAIN: certificate}, signature, ead)


def _body(item: bytes) -> bytes:
    return item[_HEADS.get(item[:1], 1) :]


def _small_int(byte: int) -> int:
    return byte if byte < _NEGATIVE else _NEGATIVE - 1 - byte


def _sequence(data: bytes, limit: int) -> list[Value]:
    try:
        return decode_sequence(data, limit=limit)
    except EncodingError as error:
        raise HandshakeFailed(f"malformed handshake message: {error}") from error


def _decode_suites(value: Value) -> tuple[int, ...]:
    # Suites = [2* int] / int (RFC 9528 section 5.2.1).
    items = value if isinstance(value, list) else [value]
    ints = [item for item in items if isinstance(item, int) and not isinstance(item, bool)]
    if len(ints) != len(items) or len(items) > MAX_SUITES:
        raise HandshakeFailed("malformed list of cipher suites")
    if isinstance(value, list) and len(items) < 2:
        raise HandshakeFailed("a single cipher suite in an array")
    return tuple(ints)


def _decode_identifier(value: Value) -> bytes:
    if isinstance(value, bytes) and not _is_small_int(value):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and -24 <= value <= 23:
        return encode(value)
    raise HandshakeFailed("malformed connection identifier")


def _is_small_int(value: bytes) -> bool:
    return len(value) == 1 and (value[0] <= 0x17 or 0x20 <= value[0] <= 0x37)


def _check_ead(items: list[Value]) -> bytes:
    previous_was_label = False
    for item in items:
        if isinstance(item, bytes) and previous_was_label:
            previous_was_label = False
        elif isinstance(item, int) and not isinstance(item, bool):
            if item < 0:  # critical: RFC 9528 section 3.8
                raise HandshakeFailed("a critical extension this release does not know")
            previous_was_label = True
        else:
            raise HandshakeFailed("malformed external authorization data")
    return b"".join(map(encode, items))
