import logging
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


def test_a_policy_that_is_none_keeps_the_master_from_starting(empty: Shell) -> None:
    said = empty("master", "--post-quantum", "requre")
    refused(said, "the post-quantum policy is 'requre'", "did you mean require?")


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


def logged(message: str, *values: object, error: Exception | None = None) -> str:
    info = (type(error), error, None) if error is not None else None
    record = logging.LogRecord("x", logging.WARNING, "", 0, message, values, info)
    return main.OneLine("rossec: %(levelname)s: %(message)s").format(record)


def test_what_peers_say_cannot_forge_a_log_line() -> None:
    hostile = "x\nrossec: WARNING: all is well\x1b[1A\u202e"
    escaped = r"x\u000arossec: WARNING: all is well\u001b[1A\u202e"
    assert logged("refused %s", hostile) == f"rossec: WARNING: refused {escaped}"
    assert logged(f"refused {hostile}") == f"rossec: WARNING: refused {escaped}"
    lines = logged("crashed", error=ValueError(hostile)).splitlines()
    assert lines[0] == "rossec: WARNING: crashed"
    assert len(lines) == 3
    assert all(line.startswith("    ") and line.isprintable() for line in lines[1:])


def test_logs_leave_through_it(monkeypatch: pytest.MonkeyPatch, empty: Shell) -> None:
    used: list[logging.Handler] = []
    monkeypatch.setattr(logging, "basicConfig", lambda level, handlers: used.extend(handlers))
    empty("grant", "--help")
    assert [type(handler.formatter) for handler in used] == [main.OneLine]


def test_the_program_exits_with_the_code(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.argv", ["rossec", "ca", "show"])
    monkeypatch.setenv("ROSSEC_HOME", str(tmp_path))
    with pytest.raises(SystemExit) as caught:
        main.main()
    assert caught.value.code == 1
