import logging
import subprocess
import sys
from pathlib import Path

import pytest

from rossec.cli import main
from tests.support.commands import Shell, refused

_LISTED = """
import contextlib, io, os, sys
held = set(sys.modules)  # what measures coverage has its own
from rossec.cli.main import rossec, run
out = io.TextIOWrapper(io.BytesIO(), write_through=True)
with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
    for words in ["-h", *(f"{name} -h" for name in GROUPS), "mastr", "ca sgin"]:
        run(words.split(), {})
    for words in ["", "m", *(f"{name} " for name in GROUPS)]:
        os.environ |= {"COMP_WORDS": f"rossec {words}", "COMP_CWORD": str(1 + words.count(" "))}
        os.environ["_ROSSEC_COMPLETE"] = "bash_complete"
        with contextlib.suppress(SystemExit):
            rossec.main([], prog_name="rossec")
    del os.environ["_ROSSEC_COMPLETE"]
said = out.buffer.getvalue().decode()
assert all(line in said for line in ("plain,privacy", "plain,opt-out", "Did you mean 'sign'?"))
heavy = {"numpy", "cryptography", "asyncio", "rosbags", "sqlite3", "ruamel", "cbor2"}
print(sorted(heavy & (sys.modules.keys() - held)))
"""
GROUPS = (
    "ca",
    "ca intermediate",
    "ca log",
    "grant",
    "master",
    "node",
    "param",
    "policy",
    "privacy",
    "service",
    "topic",
)


def test_listing_commands_imports_none_of_them() -> None:
    """Help and completion must not take longer than a person waits for a key."""
    command = [sys.executable, "-I", "-c", _LISTED.replace("GROUPS", repr(GROUPS))]
    subprocess.run(
        command, check=True, capture_output=True
    )  # in a source tree the first look imports, and keeps the outlines
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"


def test_version_and_help_are_printed(empty: Shell) -> None:
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


def test_an_invalid_post_quantum_policy_is_refused(empty: Shell) -> None:
    said = empty("master", "--post-quantum", "requre")
    refused(said, "the post-quantum policy is 'requre'", "did you mean require?")


def logged(message: str, *values: object, error: Exception | None = None) -> str:
    info = (type(error), error, None) if error is not None else None
    record = logging.LogRecord("x", logging.WARNING, "", 0, message, values, info)
    return main.OneLine("rossec: %(levelname)s: %(message)s").format(record)


def test_text_of_peers_cannot_forge_a_log_line() -> None:
    hostile = "x\nrossec: WARNING: all is well\x1b[1A\u202e"
    escaped = r"x\u000arossec: WARNING: all is well\u001b[1A\u202e"
    assert logged("refused %s", hostile) == f"rossec: WARNING: refused {escaped}"
    assert logged(f"refused {hostile}") == f"rossec: WARNING: refused {escaped}"
    lines = logged("crashed", error=ValueError(hostile)).splitlines()
    assert lines[0] == "rossec: WARNING: crashed"
    assert len(lines) == 3
    assert all(line.startswith("    ") and line.isprintable() for line in lines[1:])


def test_logs_are_formatted_on_one_line(monkeypatch: pytest.MonkeyPatch, empty: Shell) -> None:
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
