"""`rossec ca unlock | lock | status`: the service that runs, as its user sees it."""

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell, refused
from tests.support.keyservice import RunningService, running_service


@pytest.fixture
def service(shell: Shell) -> Iterator[RunningService]:
    with running_service(AuthorityHome.at(shell.root)) as service:
        yield service


def test_without_a_service_it_says_so(shell: Shell) -> None:
    said = shell("ca", "status")
    assert said.code == 0
    assert "no service runs" in said.out
    assert json.loads(shell("ca", "status", "--json").out) == {"running": False}
    refused(shell("ca", "lock"), "the authority's service does not run", "rossec ca serve")
    refused(shell.unlocked("ca", "unlock"), "the authority's service does not run")


def test_without_an_authority_it_says_so(empty: Shell) -> None:
    for verb in ("status", "lock"):
        refused(empty("ca", verb), "there is no authority", "rossec ca init")


def test_commands_need_no_passphrase_while_it_is_unlocked(shell: Shell, service: RunningService) -> None:
    assert "unlocked for 1h" in shell.unlocked("ca", "unlock", "--for", "1h").out
    assert shell("ca", "refresh").code in {0, 3}
    assert service.audit[-1].startswith("signs a head of the log")
    found = json.loads(shell("ca", "status", "--json").out)
    assert found.pop("remaining") in range(3590, 3601)
    assert (found["running"], found["locked"], found["domain"]) == (True, False, "home")
    assert "unlocked for" in shell("ca", "status").out
    assert "locked; unlock it with" in shell("ca", "lock").out
    refused(shell("ca", "refresh"), "the authority's service is locked", "rossec ca unlock --for")
    refused(shell.unlocked("ca", "refresh"), "the authority's service is locked")
    assert service.audit[-1].startswith("locked by user")


def test_unlocking_waits_for_a_service_that_is_starting(shell: Shell) -> None:
    home = AuthorityHome.at(shell.root)
    with ThreadPoolExecutor(1) as pool:
        unlocking = pool.submit(shell.unlocked, "ca", "unlock")
        time.sleep(0.5)
        with running_service(home):
            assert "unlocked for 15m" in unlocking.result().out


def test_zero_unlocks_for_as_long_as_it_runs(shell: Shell, service: RunningService) -> None:
    assert "unlocked while it runs" in shell.unlocked("ca", "unlock", "--for", "0").out


def test_a_wrong_passphrase_is_refused(shell: Shell, service: RunningService) -> None:
    shell.secret.write_text("something else\n")
    refused(shell.unlocked("ca", "unlock"), "the passphrase does not open")
    refused(shell.unlocked("ca", "unlock"), "the next may be tried in 1 s", "wait")


@pytest.mark.parametrize("time", ["8d", "0m", "-1", "soon"])
def test_a_time_out_of_range_is_wrong_usage(shell: Shell, time: str) -> None:
    refused(shell.unlocked("ca", "unlock", "--for", time), "", code=2)
