import contextlib
import ctypes
import errno
import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.host.local_ports import Loopback
from rossec.sidecar import child
from rossec.sidecar.child import OUTSIDE, NoSuchProgram, outer_environment, program_environment

ENVIRON = {"ROS_MASTER_URI": "http://far:11311", "ROS_HOSTNAME": "near", "HOME": "/home/me"}
LOOPBACK_URI = "http://127.0.0.1:4000/"


def test_the_program_gets_only_the_loopback_master() -> None:
    env = program_environment(ENVIRON, ENVIRON, LOOPBACK_URI)
    assert env.pop(OUTSIDE)
    assert env == {"ROS_MASTER_URI": LOOPBACK_URI, "ROS_IP": "127.0.0.1", "HOME": "/home/me"}


def test_a_nested_run_finds_what_the_outer_one_replaced() -> None:
    once = program_environment(ENVIRON, ENVIRON, LOOPBACK_URI)
    assert {key: outer_environment(once).get(key) for key in ENVIRON} == ENVIRON
    assert "ROS_IP" not in outer_environment(once)
    twice = program_environment(once, outer_environment(once), "http://127.0.0.1:5000/")
    assert json.loads(twice[OUTSIDE]) == {key: ENVIRON[key] for key in ("ROS_MASTER_URI", "ROS_HOSTNAME")}


def test_a_nested_run_finds_the_discovered_master() -> None:
    settled = ENVIRON | {"ROS_MASTER_URI": "http://found:11311"}
    once = program_environment(ENVIRON | {"ROS_MASTER_URI": "discover:"}, settled, LOOPBACK_URI)
    assert outer_environment(once)["ROS_MASTER_URI"] == "http://found:11311"


@pytest.mark.parametrize("damaged", ["", "7", "{", "[]x"])
def test_a_damaged_variable_is_an_error(damaged: str) -> None:
    with pytest.raises(ConfigurationError, match="damaged"):
        outer_environment({OUTSIDE: damaged})


@pytest.mark.parametrize(
    ("code", "expected"), [("import sys; sys.exit(7)", 7), ("import os; os.kill(os.getpid(), 9)", 128 + 9)]
)
async def test_the_exit_code_of_the_program_is_returned(code: str, expected: int) -> None:
    assert await child.run([sys.executable, "-c", code], os.environ) == expected


async def test_programs_that_cannot_be_started_have_shell_exit_codes(tmp_path: Path) -> None:
    script = tmp_path / "script"
    script.write_text("echo no first line says who runs this\n")
    script.chmod(0o755)
    for command, code in (("/no/such", 127), ("/etc/passwd", 126), (str(script), 126)):
        with pytest.raises(NoSuchProgram) as refused:
            await child.run([command], os.environ)
        assert refused.value.code == code


async def test_a_tool_that_is_not_installed_is_told_with_its_package() -> None:
    for command, said in (("rosrun", "apt install rosbash"), ("no-such", "is it installed")):
        with pytest.raises(NoSuchProgram) as refused:
            await child.run([command], {**os.environ, "PATH": "/nowhere"})
        assert said in refused.value.hint


async def test_the_program_inherits_passed_descriptors() -> None:
    ours, theirs = os.pipe()
    os.set_inheritable(theirs, True)
    try:
        assert await child.run(["sh", "-c", f"echo hello > /dev/fd/{theirs}"], os.environ) == 0
        assert os.read(ours, 100) == b"hello\n"
    finally:
        os.close(ours)
        os.close(theirs)


RUN = "import asyncio, os, sys; from rossec.sidecar import child\n"
RUN += "sys.exit(asyncio.run(child.run([sys.executable, '-c', sys.argv[1]], os.environ)))"
COUNT = """
import os, signal, sys, time
seen = []
for number in (signal.SIGINT, signal.SIGUSR1):
    signal.signal(number, lambda number, _: seen.append(number))
signal.signal(signal.SIGUSR2, lambda *_: sys.exit(10 * seen.count(2) + seen.count(10)))
print("ready", os.getppid(), flush=True)
while True:
    time.sleep(60)
"""


@contextlib.contextmanager
def on_a_terminal(redirection: str = "") -> Iterator[tuple[int, int]]:
    """The PID of a parent of a program that counts its signals, and its terminal."""
    process, terminal = pty.fork()
    if process == 0:
        command = f'exec "$0" "$@" {redirection}'
        os.execvp("sh", ["sh", "-c", command, sys.executable, "-c", RUN, COUNT])
    try:
        output = b""
        while not output.endswith(b"\r\n"):
            output += os.read(terminal, 100)
        yield int(output.split()[1]), terminal
    finally:
        os.close(terminal)


def counted_signals(parent_pid: int) -> int:
    """The program's count: ten for each SIGINT, one for each SIGUSR1."""
    os.kill(parent_pid, signal.SIGUSR2)
    return os.waitstatus_to_exitcode(os.waitpid(parent_pid, 0)[1])


def wait_delivered(parent_pid: int) -> None:
    """Wait until no signal is pending for the parent or its program."""
    (program,) = Path(f"/proc/{parent_pid}/task/{parent_pid}/children").read_text().split()
    end = time.monotonic() + 30
    for process in (parent_pid, int(program)):
        while "ShdPnd:\t0000000000000000" not in Path(f"/proc/{process}/status").read_text():
            assert time.monotonic() < end
            time.sleep(0.01)


@pytest.mark.parametrize("redirection", ["", "</dev/null"])
def test_ctrl_c_reaches_the_program_once(redirection: str) -> None:
    """The terminal sends it to the program itself, also if its input is redirected."""
    with on_a_terminal(redirection) as (parent_pid, terminal):
        os.write(terminal, b"\x03")
        assert b"^C" in os.read(terminal, 100)
        wait_delivered(parent_pid)
        assert counted_signals(parent_pid) == 10


def test_signals_of_a_process_are_forwarded_in_the_foreground_too() -> None:
    with on_a_terminal() as (parent_pid, _):
        for number in (signal.SIGINT, signal.SIGUSR1):
            os.kill(parent_pid, number)
            wait_delivered(parent_pid)
        assert counted_signals(parent_pid) == 11


def test_a_program_ends_with_its_sidecar(tmp_path: Path) -> None:
    code = "import asyncio, os; from rossec.sidecar import child; asyncio.run(child.run("
    code += "['sh', '-c', 'echo $$; exec sleep 100'], os.environ))"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as sidecar:
        assert sidecar.stdout is not None
        program = int(sidecar.stdout.readline())
        sidecar.kill()
        sidecar.wait()
        assert sidecar.stdout.read() == "", "its output ends when the program does"
    assert not Path(f"/proc/{program}/exe").exists()


def test_without_ipv4_programs_get_a_host_name() -> None:
    uri = "http://localhost:4000/"
    env = program_environment(ENVIRON, ENVIRON, uri, Loopback("::1", "localhost"))
    del env[OUTSIDE]
    own = {"ROS_HOSTNAME": "localhost", "ROS_IPV6": "on"}
    assert env == {"ROS_MASTER_URI": uri, "HOME": "/home/me", **own}


class RefusingKernel:
    """The C library of a kernel that refuses what a sidecar needs."""

    def prctl(self, *_: int) -> int:
        ctypes.set_errno(errno.EPERM)
        return -1

    signalfd = prctl

    def sigemptyset(self, _: object) -> int:
        return 0

    def sigaddset(self, _: object, __: int) -> int:
        return 0


async def test_a_kernel_that_refuses_starts_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    monkeypatch.setattr(child, "LIBC", RefusingKernel())
    with pytest.raises(OSError, match="PR_SET_CHILD_SUBREAPER"):
        child.adopt_orphans()
    with pytest.raises(OSError, match="signalfd"):
        await child.run(("/bin/true",), {})
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before
