import re
from hashlib import sha256
from io import BytesIO

import numpy as np
import pytest
import qrcode
import segno
import zxingcpp
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from ca.enrollment import qr
from ca.errors import CodeRefused

REQUEST = b"any bytes serve as a request here"


# RFC 9285 section 4.3 and 4.4
@pytest.mark.parametrize(
    ("data", "text"),
    [(b"AB", "BB8"), (b"Hello!!", "%69 VD92EX0"), (b"base-45", "UJCLQE7W581"), (b"ietf!", "QED8WEX0")],
)
def test_the_examples_of_the_rfc(data: bytes, text: str) -> None:
    assert qr.encode_base45(data) == text
    assert qr.decode_base45(text) == data


@given(st.binary(max_size=128))
def test_base45_is_a_bijection(data: bytes) -> None:
    assert qr.decode_base45(qr.encode_base45(data)) == data


@given(st.text(alphabet=st.sampled_from("0123ABC :%$"), max_size=12))
def test_every_text_decodes_to_what_encodes_to_it(text: str) -> None:
    try:
        data = qr.decode_base45(text)
    except CodeRefused:
        return
    assert qr.encode_base45(data) == text


@pytest.mark.parametrize("text", ["GGW", "::", ":::", "a", "AB8a", "A", "BB8A", "É"])
def test_invalid_base45_is_refused(text: str) -> None:
    with pytest.raises(CodeRefused, match="characters that a rossec code cannot have"):
        qr.decode_base45(text)


def test_a_label_vouches_for_one_request() -> None:
    code = qr.parse(qr.label_code(REQUEST))
    assert code == qr.Code(sha256(REQUEST).digest())
    assert code.matches(REQUEST)
    assert not code.matches(REQUEST + b" ")


def test_a_screen_code_carries_secret_end_and_address() -> None:
    text = qr.screen_code(REQUEST, b"s" * 16, 1_800_000_000, "192.168.1.7:40123")
    assert len(text) <= 117
    code = qr.parse(f"  {text}\n")
    assert code.matches(REQUEST)
    assert (code.secret, code.expires, code.address) == (b"s" * 16, 1_800_000_000, "192.168.1.7:40123")


@pytest.mark.parametrize(
    ("secret", "address"), [(b"", "a"), (b"s" * 15, "a"), (b"s" * 16, ""), (b"s" * 16, "a" * 65)]
)
def test_a_screen_code_that_would_not_fit(secret: bytes, address: str) -> None:
    with pytest.raises(CodeRefused, match="needs 16 bytes of secret"):
        qr.screen_code(REQUEST, secret, 0, address)


@pytest.mark.parametrize("text", ["", "ROSSEC", "rossec:BB8", "https://example.com", "ROSSEC:" + "0" * 600])
def test_other_texts_are_not_codes(text: str) -> None:
    with pytest.raises(CodeRefused, match="not the text of a rossec code") as caught:
        qr.parse(text)
    assert "ROSSEC:" in caught.value.hint


@pytest.mark.parametrize("cut", [8, 20, -3, -6])
def test_a_code_cut_short(cut: int) -> None:
    with pytest.raises(CodeRefused, match=r"incomplete or damaged|characters that"):
        qr.parse(qr.label_code(REQUEST)[:cut])


def test_a_version_from_the_future() -> None:
    with pytest.raises(CodeRefused, match="another version"):
        qr.parse(qr.PREFIX + qr.encode_base45(bytes([0x12]) + bytes(32)))


@pytest.mark.parametrize("where", [b"\xff", b"a" * 65])
def test_an_invalid_address_is_refused(where: bytes) -> None:
    with pytest.raises(CodeRefused, match="address"):
        qr.parse(qr.PREFIX + qr.encode_base45(bytes([0x21]) + bytes(52) + where))


def test_an_empty_code() -> None:
    with pytest.raises(CodeRefused, match="incomplete"):
        qr.parse(qr.PREFIX)


@pytest.mark.parametrize("text", [qr.label_code(REQUEST), qr.screen_code(REQUEST, b"k" * 16, 9, "[::1]:9")])
def test_the_terminal_rendering_scans(text: str) -> None:
    rendered = qr.terminal(text)
    assert zxingcpp.read_barcodes(picture(rendered))[0].text == text
    assert len(rendered.splitlines()) <= 22


def test_an_independent_encoder_agrees() -> None:
    text = qr.label_code(REQUEST)
    other = qrcode.QRCode(error_correction=qrcode.constants.ERROR_CORRECT_L)
    other.add_data(text)
    other.make()
    assert other.version == segno.make_qr(text, error="l", boost_error=False).version
    image = np.array(other.get_matrix(), dtype=np.uint8)
    assert zxingcpp.read_barcodes(enlarge(image))[0].text == text


def test_the_png_scans() -> None:
    text = qr.screen_code(REQUEST, b"s" * 16, 1000, "robot:1")
    image = Image.open(BytesIO(qr.png(text)))
    assert [code.text for code in zxingcpp.read_barcodes(image)] == [text]


def test_the_svg_is_one() -> None:
    data = qr.svg(qr.label_code(REQUEST))
    assert b"<svg" in data[:200]
    assert data.rstrip().endswith(b"</svg>")


def picture(rendered: str) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """The pixels a terminal with square half cells shows: dark on light."""
    upper, lower = "\u2580\u2588", "\u2584\u2588"
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in rendered.splitlines()]
    rows = [[char in half for char in line] for line in lines for half in (upper, lower)]
    return enlarge(np.array(rows, dtype=np.uint8))


def enlarge(
    modules: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.pad(np.kron(255 * (1 - modules), np.ones((6, 6), dtype=np.uint8)), 24, constant_values=255)


def test_a_screen_code_ends() -> None:
    code = qr.parse(qr.screen_code(REQUEST, b"s" * 16, 1000, "robot:1"))
    code.check_time(1000)
    with pytest.raises(CodeRefused, match="the code expired 1 s ago") as caught:
        code.check_time(1001)
    assert "show a new one" in caught.value.hint
    qr.parse(qr.label_code(REQUEST)).check_time(1001)


@pytest.mark.parametrize("expires", [-1, 1 << 32])
def test_expiries_out_of_range_are_refused(expires: int) -> None:
    with pytest.raises(CodeRefused, match="the expiry of a screen code is out of range"):
        qr.screen_code(REQUEST, b"s" * 16, expires, "robot:1")


def test_an_address_is_ascii() -> None:
    with pytest.raises(CodeRefused, match="an address of 1 to 64"):
        qr.screen_code(REQUEST, b"s" * 16, 9, "r\u00f6bot:1")


def test_the_secret_is_not_on_show() -> None:
    code = qr.parse(qr.screen_code(REQUEST, b"s" * 16, 1000, "robot:1"))
    assert "sss" not in repr(code)
