"""What a command may import before it does its work: most of its time is imports."""

import json
import subprocess
import sys
from importlib.metadata import version

import click
import pytest

import rossec
from rossec.cli.main import rossec as program
from rossec.cli.shared.context import LazyCommand
from tests.support.commands import Shell

NETWORK = frozenset({"asyncio", "http.client", "rossec.net", "rossec.node", "ssl", "subprocess", "xmlrpc"})
POLICY = frozenset({"grants.policy", "numpy", "rosbags", "ruamel"})
PICTURES = frozenset({"segno"})
RECORD = frozenset({"ca.store", "cbor2", "cryptography", "grants", "rossec.authority", "sqlite3"})
PROGRAM = """
import json, sys
held = set(sys.modules)
from rossec.cli.main import run
commands, environ = json.loads(sys.stdin.read())
codes = [run(words.split(), environ) for words in commands]
print("\\n" + json.dumps([codes, sorted(sys.modules.keys() - held)]))
"""


def imported(shell: Shell, *commands: str) -> set[str]:
    """Names of the modules and packages that these commands have imported when they end."""
    done = subprocess.run(
        [sys.executable, "-I", "-c", PROGRAM],
        env={},  # no coverage, which imports more
        input=json.dumps([commands, shell.environ]),
        capture_output=True,
        text=True,
        check=True,
    )
    codes, modules = json.loads(done.stdout.splitlines()[-1])
    assert set(codes) == {0}, done.stderr
    names = {name for module in modules for name in packages(module)}
    assert "rossec.cli" in names
    return names


def packages(module: str) -> list[str]:
    parts = module.split(".")
    return [".".join(parts[: count + 1]) for count in range(len(parts))]


READ = [
    "ca invitations",
    "ca list",
    "ca log",
    "ca requests",
    "ca show",
    "ca show /robot",
    "ca status",
    "ca things",
    "console approvals",
    "console phones",
    "domain list",
    "grant list",
    "node show /robot",
]


@pytest.mark.parametrize("command", READ)
def test_what_reads_the_record_needs_no_network_and_no_policy(shell: Shell, command: str) -> None:
    shell.enroll("/robot")
    assert imported(shell, command) & (NETWORK | POLICY | PICTURES) == set()


def test_what_is_said_of_commands_needs_not_even_a_key(empty: Shell) -> None:
    nouns = [
        name
        for name, listed in program.commands.items()
        if isinstance(listed, LazyCommand) and isinstance(listed.load(), click.Group)
    ]
    asked = ["--version", "--help", *(f"{noun} --help" for noun in nouns)]
    imported(empty, *asked)  # in a source tree the first look imports, and keeps the outlines
    assert imported(empty, *asked) & (NETWORK | POLICY | PICTURES | RECORD) == set()


def test_the_version_is_that_of_the_package(empty: Shell) -> None:
    assert rossec.__version__ == version("rossec")
    assert "importlib.metadata" not in imported(empty, "--version")
