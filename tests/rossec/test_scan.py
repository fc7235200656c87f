import io
import sys
from pathlib import Path

import pytest
from PIL import Image

from ca import qr
from rossec import scan
from rossec.errors import ConfigurationError

TEXT, OTHER = qr.label_code(b"one"), qr.label_code(b"other")


def picture(*codes: bytes, kind: str = "PNG") -> bytes:
    """Codes side by side, as a photograph of a table would show them."""
    tiles = [Image.open(io.BytesIO(code)).convert("L") for code in codes]
    whole = Image.new("L", (sum(tile.width for tile in tiles) + 40, 440), 255)
    for number, tile in enumerate(tiles):
        whole.paste(tile, (20 + number * tile.width, 20))
    out = io.BytesIO()
    whole.save(out, kind)
    return out.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "BMP", "PPM"])
def test_one_code_in_a_picture(kind: str) -> None:
    assert scan.code_in(picture(qr.png(TEXT), kind=kind)) == TEXT


def test_the_same_code_twice_is_one() -> None:
    assert scan.code_in(picture(qr.png(TEXT), qr.png(TEXT))) == TEXT


def test_a_file_or_standard_input(tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(picture(qr.png(TEXT)))
    assert scan.code_in_file(tmp_path / "photo.png", io.BytesIO()) == TEXT
    assert scan.code_in_file(Path("-"), io.BytesIO(picture(qr.png(OTHER)))) == OTHER


def test_not_exactly_one_code() -> None:
    with pytest.raises(ConfigurationError, match="there are 2 codes"):
        scan.code_in(picture(qr.png(TEXT), qr.png(OTHER)))
    foreign = io.BytesIO()
    import segno

    segno.make_qr("https://example.com").save(foreign, kind="png", scale=8, border=4)
    for empty in (picture(), picture(foreign.getvalue())):
        with pytest.raises(ConfigurationError, match="no rossec code") as caught:
            scan.code_in(empty)
        assert "paste the text" in caught.value.hint


def test_what_is_no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    gif = io.BytesIO()
    Image.new("L", (9, 9)).save(gif, "GIF")
    whole = picture(qr.png(TEXT))
    for data in (b"", b"text", gif.getvalue(), whole[: len(whole) // 2]):
        with pytest.raises(ConfigurationError, match="no picture that can be read"):
            scan.code_in(data)
    monkeypatch.setattr(scan, "MAX_FILE", 100)
    with pytest.raises(ConfigurationError, match="more than 100 bytes"):
        scan.code_in(whole)


def test_a_picture_that_unpacks_to_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = io.BytesIO()
    Image.new("1", (9000, 9000)).save(bomb, "PNG")
    assert len(bomb.getvalue()) < 100_000
    with pytest.raises(ConfigurationError, match="too many pixels"):
        scan.code_in(bomb.getvalue())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    with pytest.raises(ConfigurationError, match="no picture that can be read"):
        scan.code_in(bomb.getvalue())


@pytest.mark.parametrize("module", ["zxingcpp", "PIL"])
def test_without_the_extra(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    data = picture(qr.png(TEXT))
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigurationError, match="needs pillow and zxing-cpp") as caught:
        scan.code_in(data)
    assert "rossec[scan]" in caught.value.hint
