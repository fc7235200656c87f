"""`rossec master` as far as it goes without running for long; the rest is in tests/integration."""

import subprocess
import sys
from pathlib import Path

import pytest

from rossec.authority import intermediate_home
from rossec.authority.local_list import LocalList
from rossec.authority.renewals import sign_intermediate
from tests.support.commands import Shell, refused
from tests.support.site import Site


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(tmp_path / "home", capsys)


def test_a_wrong_configuration_is_refused(shell: Shell) -> None:
    config = shell.root / "master.yaml"
    config.write_text("log: json\nprot: 1\n")
    refused(shell("master", "--config", str(config)), f"{config}:2: there is no setting", "port")


def test_a_master_that_is_not_enrolled_does_not_start(shell: Shell) -> None:
    refused(shell("master"), "/master has no ca.pem", "rossec node request /master")


def test_the_host_of_an_intermediate_has_no_list_of_its_own(shell: Shell) -> None:
    """Its master waits for the root's, as one on any other host."""
    site = Site(shell.root / "site")
    request = intermediate_home.begin(shell.root, "home", "secret").read_bytes()
    _, bundle = sign_intermediate(site.authority, request, site.now(), may_enroll=False)
    intermediate_home.install(shell.root, bundle, "secret", site.now())
    assert LocalList(shell.root).newest() is None
    refused(shell("master"), "/master has no ca.pem", "rossec node request /master")


_CARRIED = """
import sys
held = set(sys.modules)  # what measures coverage has its own
import rossec.cli.main
import rossec.cli.master.serve
from rossec.net.aio.server import bind
for listener in bind("127.0.0.1", 0):
    listener.close()
heavy = ["numpy", "ruamel", "sqlite3", "zoneinfo", "difflib", "encodings.idna"]
heavy += ["grants.filters.layout", "grants.conditions.compile", "rossec.node"]
print([name for name in heavy if name in sys.modules.keys() - held])
"""


def test_a_master_imports_no_module_of_other_commands() -> None:
    """What it imports is more than two thirds of its memory."""
    command = [sys.executable, "-I", "-c", _CARRIED]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "[]\n"
