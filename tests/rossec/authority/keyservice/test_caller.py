"""Who asks, as the audit shows it: one bounded line, whatever the process calls itself."""

import os
from pathlib import Path

import pytest

from rossec.authority.keyservice.process import caller_of
from rossec.host.local_sockets import UnixPeer


def test_this_process_is_named() -> None:
    caller = caller_of(UnixPeer(os.getpid(), os.getuid()))
    words = Path("/proc/self/cmdline").read_bytes().split(b"\0")
    assert caller.command.startswith(words[0].decode())
    assert str(caller).startswith(f"user {os.getuid()}, process {os.getpid()}: ")


@pytest.mark.parametrize(
    ("content", "shown"),
    [
        (b"rossec\0ca\0list\0", "rossec ca list"),
        (b"a\nforged line\0", "a\\u000aforged line"),
        (b"\xff\xfe\0", "\ufffd\ufffd"),
        (b"", "(unknown)"),
        (b"x" * 10_000, "x" * 300 + "..."),
    ],
)
def test_a_command_line_is_one_bounded_line(tmp_path: Path, content: bytes, shown: str) -> None:
    (tmp_path / "42").mkdir()
    (tmp_path / "42" / "cmdline").write_bytes(content)
    assert caller_of(UnixPeer(42, 7), tmp_path).command == shown


def test_a_process_that_has_ended_is_unknown(tmp_path: Path) -> None:
    assert str(caller_of(UnixPeer(42, 7), tmp_path)) == "user 7, process 42: (unknown)"
