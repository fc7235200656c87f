import io
import os
from pathlib import Path

import click
import pytest

from rossec.cli.shared import passphrase
from rossec.errors import ConfigurationError


def written(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_the_passphrase_is_the_first_line_of_a_file(tmp_path: Path) -> None:
    file = written(tmp_path / "x", "four random words\nsecond line\n")
    assert passphrase.read(file, {}) == "four random words"
    assert passphrase.choose(file, {}) == "four random words"


def test_a_file_that_is_no_text(tmp_path: Path) -> None:
    file = written(tmp_path / "x", "")
    file.write_bytes(b"caf\xe9 with latin letters\n")
    with pytest.raises(ConfigurationError, match="is not UTF-8 text"):
        passphrase.read(file, {})
    file.write_bytes("café in four words\n\xff".encode() + b"\xff")
    assert passphrase.read(file, {}) == "café in four words"


def test_a_systemd_credential_is_used(tmp_path: Path) -> None:
    written(tmp_path / passphrase.CREDENTIAL, "from systemd, here")
    environ = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    assert passphrase.read(None, environ) == "from systemd, here"


def test_a_short_passphrase_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="protects nothing"):
        passphrase.choose(written(tmp_path / "x", "short"), {})


def test_the_mode_of_a_pipe_is_not_checked(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.write(writer, b"through the pipe\n")
    os.close(writer)
    assert passphrase.read(Path(f"/dev/fd/{reader}"), {}) == "through the pipe"
    os.close(reader)


def test_the_passphrase_is_read_from_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, bool]] = []

    def prompt(question: str, *, confirmation_prompt: bool, **_: object) -> str:
        asked.append((question, confirmation_prompt))
        return "typed by a person"

    monkeypatch.setattr(click, "prompt", prompt)
    assert passphrase.read(None, {}) == "typed by a person"
    assert passphrase.choose(None, {"CREDENTIALS_DIRECTORY": "/nonexistent"})
    assert [twice for _, twice in asked] == [False, True]


def test_what_is_too_short_is_said_before_it_is_asked_twice(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typed = iter(["short", "typed by a person", "typed by a person"])
    asked: list[str] = []

    def getpass(question: str) -> str:
        asked.append(question)
        return next(typed)

    monkeypatch.setattr("getpass.getpass", getpass)
    monkeypatch.setattr(passphrase, "can_hide", lambda: True)
    assert passphrase.choose(None, {}) == "typed by a person"
    assert [question.startswith("Repeat") for question in asked] == [False, False, True]
    assert "a passphrase of 5 characters protects nothing" in capsys.readouterr().err


def test_ctrl_c_at_the_prompt_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("getpass.getpass", interrupted)
    monkeypatch.setattr(passphrase, "can_hide", lambda: True)
    with pytest.raises(KeyboardInterrupt):
        passphrase.read(None, {})


def test_without_a_terminal_a_line_of_the_input_is_read_without_a_word_of_python(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], recwarn: pytest.WarningsRecorder
) -> None:
    monkeypatch.setattr(passphrase, "can_hide", lambda: False)
    monkeypatch.setattr("sys.stdin", io.StringIO("typed by a program\n"))
    assert passphrase.read(None, {}) == "typed by a program"
    assert "GetPassWarning" not in capfd.readouterr().err
    assert len(recwarn) == 0


def test_nobody_to_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody(*_: object, **__: object) -> str:
        raise click.Abort

    monkeypatch.setattr(click, "prompt", nobody)
    with pytest.raises(ConfigurationError, match="no passphrase was given") as caught:
        passphrase.read(None, {})
    assert "--passphrase-file" in caught.value.hint
