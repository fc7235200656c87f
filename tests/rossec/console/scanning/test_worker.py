"""The process that decodes pictures: what it answers, and what it cannot do."""

import io
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from ca.enrollment import qr
from rossec.console import scanning
from rossec.console.scanning import Found, Unreadable
from rossec.enrollment import scanner
from rossec.errors import KeyMessageRefused
from rossec.host import sandbox

TEXT = qr.label_code(b"a request")
OTHER = qr.label_code(b"another request")


def beside(*texts: str) -> bytes:
    """A picture with these codes."""
    codes = [Image.open(io.BytesIO(qr.png(text))).convert("L") for text in texts]
    whole = Image.new("L", (sum(each.width for each in codes), codes[0].height), 255)
    left = 0
    for each in codes:
        whole.paste(each, (left, 0))
        left += each.width
    out = io.BytesIO()
    whole.save(out, "PNG")
    return out.getvalue()


def test_the_one_code_in_a_picture_is_found() -> None:
    assert scanning.answer(qr.png(TEXT)) == Found(TEXT)


def test_a_picture_without_a_code_has_none() -> None:
    out = io.BytesIO()
    Image.new("L", (64, 64), 200).save(out, "JPEG")
    assert scanning.answer(out.getvalue()) == Found("")


def test_several_codes_are_told() -> None:
    assert scanning.answer(beside(TEXT, OTHER)) == scanning.SEVERAL


def test_what_is_no_picture_is_told() -> None:
    found = scanning.answer(b"GIF89a")
    assert isinstance(found, Unreadable)
    assert found.message == "this is not a picture that can be read"


def test_a_picture_that_takes_too_much_memory_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(_: bytes) -> list[str]:
        raise MemoryError

    monkeypatch.setattr(scanner, "texts", read)
    assert scanning.answer(b"x") == Unreadable("the picture takes more memory than allowed", scanner.CLOSER)


def test_pictures_are_served_in_their_order() -> None:
    source = io.BytesIO(scanning.frame(b"one") + scanning.frame(b"two") + b"\0")
    sink = io.BytesIO()
    scanning.serve(source, sink, lambda picture: Found(picture.decode()))
    assert sink.getvalue() == b"".join(map(scanning.write_answer, [Found("one"), Found("two")]))


def test_a_picture_that_is_too_large_ends_the_worker() -> None:
    source = io.BytesIO((scanning.MAX_PICTURE + 1).to_bytes(4) + b"x")
    with pytest.raises(KeyMessageRefused):
        scanning.serve(source, io.BytesIO(), lambda _: Found(""))


def test_what_is_given_up_does_not_depend_on_the_kernel(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The limits are set in this order; without Landlock they remain, and it is said."""
    given: list[tuple[int, int]] = []

    def refuse(_: object) -> None:
        raise OSError("no Landlock")

    monkeypatch.setattr(resource, "getrlimit", lambda _: (1, 32))
    monkeypatch.setattr(resource, "setrlimit", lambda what, most: given.append((what, most[1])))
    monkeypatch.setattr(os, "nice", lambda _: 0)
    monkeypatch.setattr(sandbox, "read_only", refuse)
    scanning.confine()
    assert dict(given) == {
        resource.RLIMIT_AS: 32,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_NOFILE: 16,
        resource.RLIMIT_NPROC: 0,
    }
    assert "can read the files of its user: no Landlock" in caplog.text


def test_the_libraries_are_loaded_before_the_process_is_confined(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    monkeypatch.setattr(sandbox, "protect_memory", lambda: steps.append("protected"))
    monkeypatch.setattr(scanning, "answer", lambda _: steps.append("loaded"))
    monkeypatch.setattr(scanning, "confine", lambda: steps.append("confined"))
    monkeypatch.setattr(scanning, "serve", lambda *_: steps.append("serves"))
    scanning.main()
    assert steps == ["protected", "loaded", "confined", "serves"]


TRIES = """
import socket, subprocess, sys
from rossec.console import scanning
scanning.answer(b"")
scanning.confine()
for name, attempt in {
    "read a file": lambda: open(sys.argv[1]).read(),
    "write a file": lambda: open(sys.argv[1], "w").write("x"),
    "start a program": lambda: subprocess.run([sys.executable, "-c", ""]),
}.items():
    try:
        attempt()
    except OSError as error:
        print("refused:", name)
found = scanning.answer(sys.stdin.buffer.read())
print(found.text)
"""


def test_a_confined_worker_reads_pictures_and_can_do_nothing_else(tmp_path: Path) -> None:
    secret = tmp_path / "ca.key"
    secret.write_text("secret")
    done = subprocess.run(
        [sys.executable, "-c", TRIES, secret],
        input=qr.png(TEXT),
        capture_output=True,
        check=True,
        cwd="/",
        env={},
    )
    assert done.stdout.decode().splitlines() == [
        "refused: read a file",
        "refused: write a file",
        "refused: start a program",
        TEXT,
    ]
    assert secret.read_text() == "secret"


def test_the_program_serves_its_standard_input() -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-m", scanning.__name__],
        input=scanning.frame(qr.png(TEXT)) * 2,
        capture_output=True,
        check=True,
        env={},
    )
    assert done.stdout == scanning.write_answer(Found(TEXT)) * 2
    assert done.stderr == b""
