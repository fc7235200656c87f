import base64
import hashlib
import hmac
import shlex
from dataclasses import replace

import pytest
import segno
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import encode
from ca.enrollment.invitation import PREFIX, InvitationCode, parse, parse_body, public_key
from ca.errors import CodeRefused
from tests.support.pki import NOW

N = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
CODE = InvitationCode(
    bytes(range(32)), bytes(range(16)), NOW, "192.168.1.7:11318", "/fleet/*", wildcard=False
)


def with_checksum(body: bytes) -> bytes:
    return body + hashlib.sha256(body).digest()[:4]


@pytest.mark.parametrize(
    "code",
    [
        CODE,
        replace(CODE, wildcard=True),
        replace(CODE, address="x" * 64, pattern="/" + "a" * 254, expires=(1 << 32) - 1),
        replace(CODE, address="[fd00::7]:1", pattern="/**", expires=0),
    ],
)
def test_the_text_holds_the_content(code: InvitationCode) -> None:
    assert parse(code.text()) == code
    assert parse(f" {code.text()}\n") == code
    assert parse_body(code.body()) == code


def test_the_text_survives_a_shell_and_stays_alphanumeric() -> None:
    text = CODE.text()
    assert shlex.quote(text) == text
    assert len(text.split()) == 1
    assert segno.make_qr(text, error="l", boost_error=False).mode == "alphanumeric"


def test_the_layout_as_specified() -> None:
    body = CODE.body()
    address = CODE.address.encode()
    assert body[:-4] == (
        b"\x31" + CODE.root + CODE.secret + NOW.to_bytes(4) + bytes([len(address)]) + address + b"/fleet/*"
    )
    assert body[-4:] == hashlib.sha256(body[:-4]).digest()[:4]
    assert replace(CODE, wildcard=True).body()[0] == 0x41


def test_the_key_as_specified() -> None:
    """HKDF-SHA-256 (RFC 5869) by hand, and the reduction of FIPS 186-5 A.2.1."""
    key = hmac.digest(bytes(32), CODE.secret, "sha256")
    info = encode(["rossec-join-key-v1", CODE.root])
    first = hmac.digest(key, info + b"\1", "sha256")
    octets = first + hmac.digest(key, first + info + b"\2", "sha256")
    scalar = int.from_bytes(octets[:48]) % (N - 1) + 1
    expected = ec.derive_private_key(scalar, ec.SECP256R1()).public_key()
    assert public_key(CODE.key).public_numbers() == expected.public_numbers()
    assert CODE.id == hashlib.sha256(CODE.key).digest()


def test_another_secret_or_root_is_another_key() -> None:
    other = replace(CODE, secret=bytes(16)), replace(CODE, root=bytes(32))
    assert len({code.id for code in (CODE, *other)}) == 3
    assert replace(CODE, address="elsewhere:1").id == CODE.id


def test_the_secret_is_not_shown() -> None:
    assert "secret" not in repr(CODE)


def test_every_shorter_or_longer_text_is_refused() -> None:
    text = CODE.text()
    for end in range(len(text)):
        with pytest.raises(CodeRefused):
            parse(text[:end])
    for more in ("A", "AA", "A" * 600):
        with pytest.raises(CodeRefused):
            parse(text + more)


def test_a_text_whose_line_was_broken_is_read() -> None:
    """By a mail or a chat."""
    text = CODE.text()
    lines = [text[at : at + 40] for at in range(0, len(text), 40)]
    assert parse(" \n" + "\r\n ".join(lines) + "\n\n") == CODE
    with pytest.raises(CodeRefused):
        parse("\n".join(lines[:-1]))


def test_every_changed_octet_is_refused() -> None:
    body = CODE.body()
    for at in range(len(body)):
        with pytest.raises(CodeRefused):
            parse_body(body[:at] + bytes([body[at] ^ 1]) + body[at + 1 :])


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("ROSSEC:AB", "not the code of an invitation"),
        (PREFIX, "incomplete or damaged"),
        (PREFIX + "a" * 80, "incomplete or damaged"),
        (PREFIX + "1" * 80, "incomplete or damaged"),
        (PREFIX + base64.b32encode(bytes(65)).decode().rstrip("="), "incomplete or damaged"),
    ],
)
def test_what_is_no_code(text: str, error: str) -> None:
    with pytest.raises(CodeRefused, match=error) as caught:
        parse(text)
    assert "rossec ca invite" in caught.value.hint


def test_a_code_has_one_spelling() -> None:
    """Base32 has bits at its end that mean nothing: they must be zero."""
    spare = next(
        replace(CODE, pattern="/" + "a" * n)
        for n in range(1, 9)
        if len(replace(CODE, pattern="/" + "a" * n).body()) % 5
    )
    text = spare.text()
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZ234567"
    other = text[:-1] + alphabet[alphabet.index(text[-1]) | 1]
    assert other != text
    with pytest.raises(CodeRefused):
        parse(other)


def test_another_version() -> None:
    body = with_checksum(b"\x32" + CODE.body()[1:-4])
    with pytest.raises(CodeRefused, match="another version"):
        parse_body(body)


@pytest.mark.parametrize(
    "tail", [b"\x05a:1", b"\xffa:1/x", b"\x03a:1x", b"\x00/x", b"\x03a 1/x", b"\x03a:1/x-", b"\x03a:1\xff"]
)
def test_malformed_texts_in_it(tail: bytes) -> None:
    with pytest.raises(CodeRefused):
        parse_body(with_checksum(CODE.body()[: 1 + 32 + 16 + 4] + tail))


@pytest.mark.parametrize(
    "change",
    [
        {"root": bytes(31)},
        {"secret": bytes(15)},
        {"expires": 1 << 32},
        {"expires": -1},
        {"address": ""},
        {"address": "x" * 65},
        {"address": "a b"},
        {"address": "é"},
        {"pattern": ""},
        {"pattern": "a"},
        {"pattern": "/" + "a" * 255},
        {"pattern": "/a b"},
    ],
)
def test_what_does_not_fit(change: dict[str, object]) -> None:
    with pytest.raises(CodeRefused):
        replace(CODE, **change)  # type: ignore[arg-type]


def test_its_time() -> None:
    CODE.check_time(NOW)
    with pytest.raises(CodeRefused, match="expired 1 s ago"):
        CODE.check_time(NOW + 1)


@pytest.mark.parametrize("point", [b"", bytes(65), b"\4" + bytes(64)])
def test_a_key_that_is_no_point(point: bytes) -> None:
    with pytest.raises(CodeRefused):
        public_key(point)
