"""What one press of Tab may import: it costs under 0.25 s of CPU, and has no network."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Final

from rossec.cli.completion.values import OPTIONS
from rossec.cli.main import rossec
from tests.rossec.cli.tables import all_commands

FORBIDDEN: Final = (
    "asyncio",
    "ca.store",
    "cbor2",
    "cryptography",
    "grants",
    "http",
    "multiprocessing",
    "numpy",
    "rosbags",
    "rossec.authority",
    "rossec.channel",
    "rossec.net",
    "ruamel",
    "select",
    "socket",
    "ssl",
    "subprocess",
    "urllib.request",
)
PROGRAM: Final = """
import json, sys
held = set(sys.modules)
from rossec.cli.main import complete
lines = json.loads(sys.stdin.read())
said = [
    complete({"ROSSEC_HOME": sys.argv[1], "_ROSSEC_COMPLETE": "zsh_complete", "COMP_LINE": line})
    for line in lines
]
print(json.dumps([sum(map(bool, said)), sorted(sys.modules.keys() - held)]))
"""


def lines() -> list[str]:
    """The options of each command, and names of each kind."""
    kinds: dict[str, str] = {}
    found = []
    for words, listed, _command in all_commands(rossec):
        start = " ".join(words)
        found.append(f"{start} -")
        for count, kind in enumerate(listed.arguments if listed else ()):
            kinds.setdefault(kind, f"{start} {'x ' * count}")
    return [*found, *kinds.values(), *(f"rossec topic echo {option} " for option in OPTIONS)]


def completed(home: Path, asked: list[str]) -> tuple[int, list[str]]:
    done = subprocess.run(
        [sys.executable, "-I", "-c", PROGRAM, str(home)],
        env={},  # no coverage, which imports more
        input=json.dumps(asked),
        capture_output=True,
        text=True,
        check=True,
    )
    count, modules = json.loads(done.stdout)
    return count, modules


def test_completion_imports_no_command_and_no_network(tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "nodes" / "robot").mkdir(mode=0o700, parents=True)
    home.chmod(0o700)
    (home / "ca").mkdir(mode=0o700)
    (home / "ca" / "ca.db").write_bytes(b"")
    (home / "ca" / "ca.db").chmod(0o600)
    asked = lines()
    completed(home, asked)  # in a source tree the first look imports, and keeps the outlines
    count, modules = completed(home, asked)
    assert count > len(asked) / 2
    assert "rossec.cli.completion.sources" in modules
    assert "sqlite3" in modules
    inside = tuple(f"{name}." for name in FORBIDDEN)
    assert [name for name in modules if name in FORBIDDEN or name.startswith(inside)] == []
    commands = {
        listed.place.split(":")[0] for _, listed, _ in all_commands(rossec) if listed and listed.arguments
    }
    assert [name for name in modules if name.removeprefix("rossec.cli.") in commands] == []
