"""The authority's service as its users have it: real processes, in a home of their own."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.host.audit import read_entries, verify
from tests.support.ports import free_port
from tests.support.serviceprocess import ServiceProcess, children_of, wait_until_gone


@pytest.fixture
def service(tmp_path: Path) -> Iterator[ServiceProcess]:
    service = ServiceProcess(tmp_path / "home")
    yield service
    service.close()


def test_commands_ask_no_passphrase_while_it_is_unlocked(service: ServiceProcess) -> None:
    ready = json.loads(service.start("--no-network"))
    assert ready["remaining"] in range(880, 901)
    service.run("node", "request", "/robot")
    csr = str(service.root / "nodes" / "robot" / "node.csr")
    service.run("ca", "sign", csr, "--yes")
    service.run("grant", "sign", "/robot", "--subscribe", "/pose")
    assert "signs a certificate of /robot" in service.audit()
    assert "signs a grant" in service.audit()
    assert "rossec ca sign" in service.audit()
    assert service.terminate() == 0
    refused = service.run("ca", "refresh", check=False)
    assert (refused.returncode, "no passphrase was given" in refused.stderr) == (1, True)


def test_when_its_time_is_over_it_refuses_with_a_hint(service: ServiceProcess) -> None:
    service.start("--no-network", "--unlock-for", "1s")
    time.sleep(1.2)
    refused = service.run("ca", "refresh", check=False)
    assert (refused.returncode, "is locked" in refused.stderr) == (1, True)
    assert "hint: unlock it with: rossec ca unlock" in refused.stderr
    service.run("ca", "unlock", "--passphrase-file", str(service.secret))
    assert json.loads(service.run("ca", "status", "--json").stdout)["locked"] is False
    service.run("ca", "lock")
    assert json.loads(service.run("ca", "status", "--json").stdout)["locked"] is True


def test_after_kill_9_the_next_one_takes_its_place(service: ServiceProcess) -> None:
    service.start("--join-address", f"127.0.0.1:{free_port()}")
    (face,) = children_of(service.pid)
    service.kill()
    assert (service.directory / "service.sock").exists()
    wait_until_gone(face)
    assert "no service runs" in service.run("ca", "status").stdout
    service.run("ca", "log", "verify")
    service.start("--no-network")
    assert service.run("ca", "refresh", check=False).returncode == 3  # signed, and no master
    entries, damaged = read_entries(service.audit().splitlines())
    assert damaged == []
    verify(entries)


def test_one_at_a_time_and_no_restore_meanwhile(service: ServiceProcess) -> None:
    service.start("--no-network")
    secret = ("--passphrase-file", str(service.secret))
    second = service.run("ca", "serve", "--no-network", *secret, check=False)
    assert (second.returncode, "service runs from" in second.stderr) == (1, True)
    service.run("ca", "backup", str(service.root / "b"), *secret)
    restore = ("ca", "restore", str(service.root / "b"), "--over", "home", "--without-list", *secret)
    refused = service.run(*restore, check=False)
    assert (refused.returncode, "service runs from" in refused.stderr) == (1, True)
    service.terminate()
    service.run(*restore)


def test_nodes_join_and_a_dead_face_is_replaced(service: ServiceProcess) -> None:
    port = free_port()
    service.start("--join-address", f"127.0.0.1:{port}")
    (face,) = children_of(service.pid)
    code = service.root / "code"
    for name in ("/a", "/b"):
        said = service.run("ca", "invite", name, "--address", f"127.0.0.1:{port}")
        code.write_text(said.stdout)
        code.chmod(0o600)
        service.run("node", "join", "--file", str(code), "--name", name)
        if name == "/a":
            os.kill(face, signal.SIGKILL)
            wait_until_gone(face)
            _wait_for_another(service.pid, face)
    assert service.audit().count("for a node that joins") == 2


def _wait_for_another(pid: int, face: int) -> None:
    end = time.monotonic() + 20
    while not set(children_of(pid)) - {face}:
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(1)  # it listens by then


def test_its_memory_is_protected(service: ServiceProcess) -> None:
    service.start("--no-network")
    limits = Path(f"/proc/{service.pid}/limits").read_text()
    (core,) = (line for line in limits.splitlines() if line.startswith("Max core file size"))
    assert core.split()[4:6] == ["0", "0"]
    status = Path(f"/proc/{service.pid}/status").read_text()
    assert "NoNewPrivs:\t1" in status
