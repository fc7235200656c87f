"""Which processes may not use the service's socket."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rossec.authority.console.serving import ConsolePeers
from rossec.errors import PeerUserRefused
from rossec.host.local_sockets import UnixPeer

CONFINED = "import resource, sys\nresource.setrlimit(resource.RLIMIT_NPROC, (0, 0))\n"
WAIT = "print(flush=True)\nsys.stdin.read()\n"


def put(proc: Path, process: int, started: int, limit: str = "unlimited") -> None:
    directory = proc / str(process)
    directory.mkdir(parents=True, exist_ok=True)
    fields = " ".join(["S", *["0"] * 18, f"{started}", "0"])
    (directory / "stat").write_text(f"{process} (a name) of (three) words) {fields}\n")
    row = f"Max processes             {limit}                {limit}                processes\n"
    (directory / "limits").write_text(f"Limit   Soft Limit   Hard Limit   Units\n{row}")


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    (tmp_path / "self").mkdir()
    put(tmp_path, 1, 10)
    put(tmp_path, 2, 20)
    return tmp_path


def is_refused(peers: ConsolePeers, process: int) -> bool:
    try:
        peers.refuse(UnixPeer(process, 0))
    except PeerUserRefused:
        return True
    return False


def test_refuse_knows_who_came_to_the_console(proc: Path) -> None:
    peers = ConsolePeers(proc)
    peers.remember(UnixPeer(1, 0))
    assert (is_refused(peers, 1), is_refused(peers, 2)) == (True, False)
    peers.remember(UnixPeer(1, 0))
    assert is_refused(peers, 1)


def test_a_number_that_is_given_again_is_another_process(proc: Path) -> None:
    peers = ConsolePeers(proc)
    peers.remember(UnixPeer(1, 0))
    put(proc, 1, 11)
    assert not is_refused(peers, 1)


def test_what_the_kernel_does_not_show_is_taken_for_the_same(proc: Path) -> None:
    peers = ConsolePeers(proc)
    (proc / "2" / "stat").write_text("")
    peers.remember(UnixPeer(1, 0))
    peers.remember(UnixPeer(2, 0))
    put(proc, 2, 22)
    (proc / "1" / "stat").unlink()
    assert is_refused(peers, 1)
    assert is_refused(peers, 2)


def test_processes_that_ended_are_forgotten(proc: Path) -> None:
    peers = ConsolePeers(proc)
    for number in range(100, 200):
        put(proc, number, number)
        peers.remember(UnixPeer(number, 0))
        (proc / str(number)).rename(proc / f"gone{number}")
    peers.remember(UnixPeer(1, 0))
    assert is_refused(peers, 1)
    assert not is_refused(peers, 150)


def test_without_proc_nobody_who_came_is_forgotten(tmp_path: Path) -> None:
    peers = ConsolePeers(tmp_path / "no")
    peers.remember(UnixPeer(1, 0))
    peers.remember(UnixPeer(2, 0))
    assert is_refused(peers, 1)
    assert not is_refused(peers, 3)


def test_a_process_that_may_start_no_other_is_refused(proc: Path) -> None:
    peers = ConsolePeers(proc)
    put(proc, 3, 30, limit="0")
    assert is_refused(peers, 3)
    put(proc, 4, 40, limit="1")
    (proc / "2" / "limits").write_text("")
    assert not is_refused(peers, 4)
    assert not is_refused(peers, 2)


@pytest.mark.parametrize("code", ["import sys\n", CONFINED])
def test_refuse_reads_what_this_kernel_writes(code: str) -> None:
    arguments = [sys.executable, "-I", "-c", code + WAIT]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        peers = ConsolePeers()
        assert is_refused(peers, process.pid) is (code == CONFINED)
        peers.remember(UnixPeer(process.pid, os.getuid()))
        assert is_refused(peers, process.pid)
        process.communicate()
    assert not is_refused(peers, process.pid)
