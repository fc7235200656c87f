import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.sidecar import child
from rossec.sidecar.child import OUTSIDE, NoSuchProgram, inside, outside

HERE = {"ROS_MASTER_URI": "http://far:11311", "ROS_HOSTNAME": "near", "HOME": "/home/me"}
LOOPBACK_URI = "http://127.0.0.1:4000/"


def test_the_program_sees_loopback_alone() -> None:
    env = inside(HERE, LOOPBACK_URI)
    assert env.pop(OUTSIDE)
    assert env == {"ROS_MASTER_URI": LOOPBACK_URI, "ROS_IP": "127.0.0.1", "HOME": "/home/me"}


def test_a_nested_run_finds_what_the_outer_one_replaced() -> None:
    once = inside(HERE, LOOPBACK_URI)
    assert {key: outside(once).get(key) for key in HERE} == HERE
    assert "ROS_IP" not in outside(once)
    twice = inside(once, "http://127.0.0.1:5000/")
    assert json.loads(twice[OUTSIDE]) == {
        key: HERE[key] for key in ("ROS_MASTER_URI", "ROS_HOSTNAME")
    }


@pytest.mark.parametrize("damaged", ["", "7", "{", "[]x"])
def test_a_damaged_variable_is_named(damaged: str) -> None:
    with pytest.raises(ConfigurationError, match="damaged"):
        outside({OUTSIDE: damaged})


@pytest.mark.parametrize(
    ("code", "expected"),
    [("import sys; sys.exit(7)", 7), ("import os; os.kill(os.getpid(), 9)", 128 + 9)],
)
async def test_exit_codes(code: str, expected: int) -> None:
    assert await child.run([sys.executable, "-c", code], os.environ) == expected


@pytest.mark.parametrize(("command", "code"), [("/no/such", 127), ("/etc/passwd", 126)])
async def test_programs_that_cannot_be_started(command: str, code: int) -> None:
    with pytest.raises(NoSuchProgram) as refused:
        await child.run([command], os.environ)
    assert refused.value.code == code


async def test_signals_are_passed_on() -> None:
    script = "import os, signal, sys; signal.signal(signal.SIGUSR1, lambda *_: sys.exit(5))\n"
    script += "os.kill(os.getppid(), signal.SIGUSR1)\nsignal.pause()"
    assert await child.run([sys.executable, "-c", script], os.environ) == 5


def test_a_program_ends_with_its_sidecar(tmp_path: Path) -> None:
    code = "import asyncio, os; from rossec.sidecar import child; asyncio.run(child.run("
    code += "['sh', '-c', 'echo $$; exec sleep 100'], os.environ))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as sidecar:
        assert sidecar.stdout is not None
        program = int(sidecar.stdout.readline())
        sidecar.kill()
        sidecar.wait()
        assert sidecar.stdout.read() == "", "its output ends when the program does"
    assert not Path(f"/proc/{program}/exe").exists()
