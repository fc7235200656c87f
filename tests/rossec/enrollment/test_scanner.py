"""What the process that looks at a picture finds in it, and where it stops."""

import io
import json
import os
import resource
import sys

import pytest
from PIL import Image

from ca.enrollment import qr
from rossec.enrollment import scanner
from rossec.errors import ConfigurationError
from tests.rossec.enrollment.test_scan import OTHER, TEXT, picture


def test_the_codes_in_a_picture_each_once() -> None:
    codes = (qr.png(TEXT), qr.png(OTHER), qr.png(TEXT))
    assert scanner.texts(picture(*codes)) == sorted([TEXT, OTHER])
    assert scanner.texts(picture()) == []


def test_data_that_is_not_a_picture_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    gif = io.BytesIO()
    Image.new("L", (9, 9)).save(gif, "GIF")
    whole = picture(qr.png(TEXT))
    for data in (b"", b"text", gif.getvalue(), whole[: len(whole) // 2]):
        with pytest.raises(ConfigurationError, match="not a picture that can be read"):
            scanner.texts(data)
    monkeypatch.setattr(scanner, "MAX_FILE", 100)
    with pytest.raises(ConfigurationError, match="more than 100 bytes"):
        scanner.texts(whole)


def test_a_picture_that_unpacks_to_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = io.BytesIO()
    Image.new("1", (9000, 9000)).save(bomb, "PNG")
    assert len(bomb.getvalue()) < 100_000
    with pytest.raises(ConfigurationError, match="too many pixels"):
        scanner.texts(bomb.getvalue())
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    with pytest.raises(ConfigurationError, match="not a picture that can be read"):
        scanner.texts(bomb.getvalue())


@pytest.mark.parametrize("module", ["zxingcpp", "PIL"])
def test_a_scanner_needs_the_extra(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    data = picture(qr.png(TEXT))
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigurationError, match="needs pillow and zxing-cpp") as caught:
        scanner.texts(data)
    assert "rossec[scan]" in caught.value.hint


def answer(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> object:
    stdin = io.TextIOWrapper(io.BytesIO(picture(qr.png(TEXT))))
    monkeypatch.setattr(sys, "stdin", stdin)
    monkeypatch.setattr(resource, "setrlimit", lambda *_: None)  # not of this process
    assert scanner.main() == os.EX_OK
    return json.loads(capsys.readouterr().out)


def test_one_line_answers(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert answer(monkeypatch, capsys) == {"texts": [TEXT]}
    monkeypatch.setattr(scanner, "MAX_PIXELS", 1)
    said = {"error": "the picture has too many pixels", "hint": "make it smaller"}
    assert answer(monkeypatch, capsys) == said

    def exhaust(data: bytes) -> list[str]:
        raise MemoryError

    monkeypatch.setattr(scanner, "texts", exhaust)
    assert answer(monkeypatch, capsys) == {
        "error": "the picture takes more memory than allowed",
        "hint": scanner.CLOSER,
    }


def test_a_limit_is_never_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: dict[int, tuple[int, int]] = {}
    monkeypatch.setattr(resource, "setrlimit", kept.__setitem__)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (5, 5))
    scanner._limit(1, 9)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (5, resource.RLIM_INFINITY))
    scanner._limit(2, 9)
    assert kept == {1: (5, 5), 2: (9, 9)}
