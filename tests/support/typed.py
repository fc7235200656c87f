"""A how-to, typed as printed: its blocks of commands in the shells of the hosts they are for.

A block is what stands in a fence behind `<!-- HOST WORDS -->`. A shell is a bash on a terminal in
its host's network namespace; a person answers its prompts. After commands that go on in the
background it waits until they work, as a person sees by their output.
"""

import contextlib
import itertools
import os
import pty
import re
import select
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from tests.integration.test_first_steps import BIN, SECRET
from tests.support.hosts import Host

_BLOCK: Final = re.compile(r"<!-- (\w+)[^>]*-->\n```\w*\n(.*?)```", re.DOTALL)
_READY: Final = {
    "rossec border": "until rossec border status >/dev/null 2>&1; do sleep 0.1; done",
    "rossec ca serve": "until rossec ca status >/dev/null 2>&1; do sleep 0.1; done",
    "rossec master": "until (: >/dev/tcp/$ROS_IP/11311) 2>/dev/null; do sleep 0.1; done",
    "rossec gateway": "until rossec gateway status 2>&1 | grep -q ' as /gateway/'; do sleep 0.1; done",
    "rossec namespace serve": "until rossec service list --as /namespace"
    " 2>/dev/null | grep -q get_topic_name; do sleep 0.1; done",
    "rossec relay": "until rossec relay status >/dev/null 2>&1; do sleep 0.1; done",
    "rossec router": "until (: >/dev/tcp/127.0.0.1/7447) 2>/dev/null; do sleep 0.1; done",
}
_BACKGROUND: Final = re.compile(rf"(?m)^({'|'.join(_READY)})\b[^\n]*&[^\n]*$")
_ENDED: Final = "shell ended early"
_YES_OR_NO: Final = "[y/N]: "
_PASSPHRASE: Final = "passphrase of the authority's key: "


class Block(NamedTuple):
    """Commands for one host."""

    host: str
    commands: str


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a how-to, in its order."""
    return [Block(*found) for found in _BLOCK.findall(page.read_text())]


class TypedShell:
    """A shell on `host`, with `home` as the home directory."""

    def __init__(self, host: Host, home: Path, **variables: str) -> None:
        home.mkdir(mode=0o700, exist_ok=True)
        self.home = home
        self.said = ""
        self._numbers = itertools.count(1)
        environ = {"HOME": str(home), "PATH": f"{BIN}:/usr/bin:/bin", "TERM": "dumb", **variables}
        self._pid, self._terminal = pty.fork()
        if self._pid == 0:
            os.chdir(home)
            command = host.at("/bin/bash", "--noprofile", "--norc", "-s")
            os.execvpe(command[0], command, {**environ, "PATH": f"{environ['PATH']}:/usr/sbin"})
        self.type(f"stty -echo; set -e; trap \"printf '{_ENDED[:5]}%s' '{_ENDED[5:]}'\" EXIT")

    def type(self, commands: str, within: float = 60.0) -> str:
        """Run `commands` to their end; what was printed meanwhile.

        Raises:
            AssertionError: one of them failed, or does not end.
        """
        number = next(self._numbers)
        script = self.home / f".block{number}"
        script.write_text(_BACKGROUND.sub(lambda found: f"{found[0]}\n{_READY[found[1]]}", commands))
        self._write(f". {script}; printf 'end %s\\n' {number}-\n")
        return self._until(f"end {number}-", within)

    def close(self) -> None:
        """Hang up, then kill what is left of its session."""
        for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGKILL):
            for process in _session(self._pid):
                with contextlib.suppress(ProcessLookupError):  # it ended meanwhile
                    os.kill(process, number)
            time.sleep(0.2 if number != signal.SIGKILL else 0)
        os.waitpid(self._pid, 0)
        os.close(self._terminal)

    def _until(self, words: str, within: float) -> str:
        said, answered, end = "", 0, time.monotonic() + within
        while words not in said:
            part = self._read(end)
            said += part
            self.said += part
            assert part, f"it did not say {words!r}: {self.said}"
            assert _ENDED not in said, f"a command failed: {self.said}"
            if (answer := _answer(said[answered:])) and not self._goes_on():
                answered = len(said)
                self._write(answer + "\n")
        return said

    def _goes_on(self) -> bool:
        """Whether more is printed: then it was the beginning of a line, `pose: ` of a message."""
        return bool(select.select([self._terminal], [], [], 0.2)[0])

    def _read(self, end: float) -> str:
        left = max(0.0, end - time.monotonic())
        if not select.select([self._terminal], [], [], left)[0]:
            return ""
        try:
            return os.read(self._terminal, 65536).decode(errors="replace")
        except OSError:  # Linux: the other end is closed
            return ""

    def _write(self, text: str) -> None:
        os.write(self._terminal, text.encode())


def _answer(prompt: str) -> str:
    """What a person types at the end of this output; nothing: it is no prompt.

    A job in the background may print behind a question: a person answers it all the same.
    """
    if _YES_OR_NO in prompt:
        return "y"
    if _PASSPHRASE in prompt or prompt.rpartition("\n")[2].endswith(": "):
        return SECRET
    return ""


def _session(leader: int) -> list[int]:
    """The processes in the session of `leader`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if os.getsid(int(entry.name)) == leader:
                found.append(int(entry.name))
        except ProcessLookupError:
            continue
    return found


def shells_of(hosts: Mapping[str, Host], root: Path) -> dict[str, TypedShell]:
    """A shell for each host; they share `~/stick`, a stick that a person carries."""
    (root / "stick").mkdir(mode=0o700)
    shells = {}
    for name, host in hosts.items():
        home = root / name
        home.mkdir(mode=0o700)
        (home / "stick").symlink_to(root / "stick")
        shells[name] = TypedShell(host, home)
    return shells
