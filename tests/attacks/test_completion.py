"""Names that reach completion from elsewhere, in real shells on a terminal: nothing is executed."""

import json
import os
import pty
import select
import shutil
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import pytest

from rossec.cli.completion import values
from rossec.cli.completion.shells import script

pytestmark = [pytest.mark.attack("hostile-completion"), pytest.mark.timeout(300)]

ROSSEC: Final = str(Path(sys.executable).with_name("rossec"))
SHELLS: Final = {"bash": ("--norc", "--noprofile", "-i"), "zsh": ("-f", "-i"), "fish": ("--no-config", "-i")}
HOSTILE: Final = (
    "good$(touch PWNED)",
    "good`touch PWNED`",
    "good;touch PWNED",
    "good\ntouch PWNED\n",
    "good'\"$(touch PWNED)",
    "good*",
    "good\x1b]0;PWNED\x07",
    "good\x1b[2J",
    "good\tplain,x",
    "good,plain,$(touch PWNED)",
    "-good",
    "good\u202edwoP",
    "~good",
    "good|touch PWNED",
    "good&touch PWNED&",
    "${x:=PWNED}good",
    "good>PWNED",
    "good\\",
    "!!good",
)
PATIENCE: Final = 30.0  # seconds


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A home in which everything that completion reads has hostile names."""
    path = tmp_path / "home"
    (path / "nodes" / "good").mkdir(parents=True)
    (path / "ca").mkdir()
    for text in HOSTILE:
        (path / "nodes" / text.replace("/", ".")).mkdir(exist_ok=True)
    named = [f"/{text}" for text in HOSTILE]
    kept = {kind: [*named, "/good"] for kind in (values.TOPIC, values.NODE, values.TYPE, values.SERVICE)}
    (path / values.NAME).write_text(json.dumps({"master": "", "names": kept}))
    (path / "ca" / "policy.yaml").write_text("\n".join([*named, "/good"]))
    with sqlite3.connect(path / "ca" / "ca.db") as db:
        db.execute("CREATE TABLE certificate (name, thumbprint, not_after)")
        db.execute("CREATE TABLE revocation (entry)")
        rows = [(name, b"", 2**40) for name in [*named, "/good"]]
        db.executemany("INSERT INTO certificate VALUES (?, ?, ?)", rows)
    db.close()
    for each in [path, *path.rglob("*")]:
        each.chmod(0o700)
    return path


def environ(home: Path) -> dict[str, str]:
    found = {name: value for name, value in os.environ.items() if not name.startswith("ROS")}
    return {**found, "ROSSEC_HOME": str(home), "HOME": str(home), "TERM": "xterm"}


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize("line", ["node show ", "topic echo ", "topic echo /x ", "ca renew "])
def test_no_hostile_name_is_offered(home: Path, shell: str, line: str) -> None:
    typed = {"COMP_LINE": f"rossec {line}", "_ROSSEC_COMPLETE": f"{shell}_complete"}
    done = subprocess.run([ROSSEC], capture_output=True, text=True, check=True, env=environ(home) | typed)
    words = {row.replace(",", "\t").split("\t")[1] for row in done.stdout.splitlines()}
    assert "/good" in words or "std_msgs/String" in words
    assert all(set(word) <= set("_./-:+") | {c for c in word if c.isalnum()} for word in words)
    assert "PWNED" not in done.stdout
    assert done.stderr == ""


class Terminal:
    """A shell on a terminal, and the person at it."""

    def __init__(self, shell: str, home: Path, directory: Path) -> None:
        self.shown = ""
        self._child, self._terminal = pty.fork()
        if self._child == 0:
            os.chdir(directory)
            os.execvpe(shell, [shell, *SHELLS[shell]], environ(home))

    def type(self, text: str, until: str) -> str:
        """Type `text`; returns what appears until `until` does (Ctrl-U takes a line back)."""
        os.write(self._terminal, text.encode())
        found, ends = "", time.monotonic() + PATIENCE
        while until not in found and time.monotonic() < ends:
            if select.select([self._terminal], [], [], 1)[0]:
                found += os.read(self._terminal, 65536).decode(errors="replace")
        assert until in found, found
        self.shown += found
        return found

    def end(self) -> None:
        os.close(self._terminal)
        os.waitpid(self._child, 0)


@pytest.mark.parametrize("shell", SHELLS)
def test_tab_executes_nothing(home: Path, tmp_path: Path, shell: str) -> None:
    """Neither names of the home, nor what stands on the line, nor a program named `rossec`."""
    if shutil.which(shell) is None:
        pytest.skip(f"NOT RUN: no {shell} on this machine")
    here = tmp_path / "here"
    here.mkdir()
    (here / "rossec").write_text("#!/bin/sh\ntouch PWNED\n")
    (here / "rossec").chmod(0o700)
    (tmp_path / "script").write_text(script(shell, ROSSEC))
    terminal = Terminal(shell, home, here)
    try:
        setup = "autoload -U compinit && compinit -D -u; " if shell == "zsh" else ""
        terminal.type(f"{setup}. {tmp_path}/script; echo set''up\n", "setup")
        for line in ("rossec node show /g", "./rossec node show /g", "rossec topic echo /g"):
            terminal.type(f"{line}\t", "/good")
            terminal.type("\x15echo ne''xt\n", "next")
        for line in ("rossec node show $(touch PWNED", "rossec ca `touch PWNED", "rossec ca '$(x"):
            terminal.type(f"{line}\t\t\x15echo ne''xt\n", "next")
        terminal.type("echo al''ive\n", "alive")
    finally:
        terminal.end()
    assert not list(tmp_path.rglob("PWNED"))
    assert "dwoP" not in terminal.shown
    assert sorted(path.name for path in here.iterdir()) == ["rossec"]
