import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.cli import manual as pages


@given(st.text())
def test_text_is_one_line_of_ascii_and_no_request(text: str) -> None:
    line = pages.escape(text)
    assert line.isascii()
    assert "\n" not in line
    assert line[:1] not in {".", "'"}


def test_characters_are_printed_as_themselves(tmp_path: object) -> None:
    if shutil.which("man") is None:
        pytest.skip("NOT RUN: no man on this machine")
    text = "a\\b -x --long `c` 'd' \"e\" ~f ^g .h é → 100%"
    page = "\n".join([pages.title("t", "s"), pages.section("NAME"), *pages.verbatim([text, ".x", ""])])
    found = subprocess.run(
        ["man", "--warnings", "-l", "-"],
        input=page,
        text=True,
        capture_output=True,
        check=True,
        env={"LC_ALL": "C.UTF-8", "PATH": "/usr/bin:/bin", "MANWIDTH": "100"},
    )
    assert found.stderr == ""
    assert text in found.stdout
    assert "\n           .x\n" in found.stdout


def test_the_macros_of_a_page() -> None:
    assert pages.title("a-b", "a 1") == r'.TH "A\-B" 1 "" "a 1" "rossec manual"'
    assert pages.subsection("x") == '.SS "x"'
    assert pages.paragraph("a\n  b") == [".PP", "a b"]
    assert pages.item(pages.bold("--x"), "") == [".TP", r"\fB\-\-x\fR", r"\&"]
    assert pages.italic("A") == r"\fIA\fR"
    assert pages.escape("a\x1bb") == "a b"
