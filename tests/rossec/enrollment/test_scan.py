import io
import sys
from pathlib import Path

import pytest
from PIL import Image

from ca.enrollment import qr
from rossec.enrollment import enroll
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
    assert enroll.code_in(picture(qr.png(TEXT), kind=kind)) == TEXT


def test_the_same_code_twice_is_one() -> None:
    assert enroll.code_in(picture(qr.png(TEXT), qr.png(TEXT))) == TEXT


def test_a_file_or_standard_input(tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(picture(qr.png(TEXT)))
    assert enroll.code_in_file(tmp_path / "photo.png", io.BytesIO()) == TEXT
    assert enroll.code_in_file(Path("-"), io.BytesIO(picture(qr.png(OTHER)))) == OTHER


def test_a_picture_has_exactly_one_code() -> None:
    with pytest.raises(ConfigurationError, match="there are 2 codes"):
        enroll.code_in(picture(qr.png(TEXT), qr.png(OTHER)))
    foreign = io.BytesIO()
    import segno

    segno.make_qr("https://example.com").save(foreign, kind="png", scale=8, border=4)
    for empty in (picture(), picture(foreign.getvalue())):
        with pytest.raises(ConfigurationError, match="no rossec code") as caught:
            enroll.code_in(empty)
        assert "paste the text" in caught.value.hint


def test_data_that_is_not_a_picture_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match="not a picture that can be read") as caught:
        enroll.code_in(b"text")
    assert "use one of PNG" in caught.value.hint
    monkeypatch.setattr(enroll, "MAX_FILE", 100)
    with pytest.raises(ConfigurationError, match="more than 100 bytes"):
        enroll.code_in(picture(qr.png(TEXT)))


@pytest.mark.parametrize("program", ["raise SystemExit(1)", "print('{')", "import time; time.sleep(60)"])
def test_a_reader_that_fails_or_hangs(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    monkeypatch.setattr(enroll, "SCANNER", (sys.executable, "-I", "-c", program))
    monkeypatch.setattr(enroll, "SECONDS", 1)
    with pytest.raises(ConfigurationError, match="took too long, or failed") as caught:
        enroll.code_in(b"")
    assert "paste the text" in caught.value.hint
