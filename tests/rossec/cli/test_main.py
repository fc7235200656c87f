import os
from pathlib import Path

import click
import pytest

from rossec.cli import main
from rossec.errors import ConfigurationError, NotDelivered
from tests.support.commands import Shell, refused


def test_version_and_help(empty: Shell) -> None:
    assert empty("--version").out.startswith("rossec 0.")
    assert "Security and access grants for ROS 1" in empty("--help").out
    said = empty("ca")
    assert (said.code, "Commands" in said.out) == (2, True)


@pytest.mark.parametrize("noun", ["ca", "node", "grant", "topic", "master", "demo"])
def test_every_noun_has_help(empty: Shell, noun: str) -> None:
    assert empty(noun, "--help").code == 0


def test_wrong_usage_says_where_help_is(empty: Shell) -> None:
    refused(empty("frobnicate"), "no such command 'frobnicate'", "see: rossec --help", code=2)
    refused(empty("ca", "init"), "missing argument", "see: rossec ca init --help", code=2)
    refused(empty("ca", "init", "home", "--nope"), "no such option", code=2)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigurationError("no", "do"), 1),
        (NotDelivered("no", "do"), 3),
        (click.ClickException("Something."), 1),
        (KeyboardInterrupt(), 130),
        (EOFError(), 130),
        (FileNotFoundError(2, "No such file", "x"), 1),
        (OSError("strange"), 1),
    ],
)
def test_every_end_has_its_code(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(main.rossec, "main", fail)
    assert main.run([], os.environ) == code


def test_the_program_exits_with_the_code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.argv", ["rossec", "ca", "show"])
    monkeypatch.setenv("ROSSEC_HOME", str(tmp_path))
    with pytest.raises(SystemExit) as caught:
        main.main()
    assert caught.value.code == 1
