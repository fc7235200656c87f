import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from rossec.cli import main
from tests.rossec.cli.node.processes import BIN, started
from tests.support.site import Site


def test_the_options_of_run_reach_the_sidecar(became: dict[str, Any]) -> None:
    main.run(["-v", "run", "--as", "/robot", "--", "prog", "--each", "-x"], {"HOME": "/h"})
    assert became["flags"] == ["-I", "-m", "rossec.sidecar"]
    assert became["command"] == ["prog", "--each", "-x"]
    assert became["identity"] == "/robot"
    assert became["each"] is False
    assert became["verbose"] is True
    assert became["env"] == {"HOME": "/h"}


def test_arguments_after_the_program_belong_to_the_program(became: dict[str, Any]) -> None:
    main.run(["run", "--each", "roslaunch", "--help", "--as", "/x", "-v"], {})
    assert became["command"] == ["roslaunch", "--help", "--as", "/x", "-v"]
    assert became["identity"] is None
    assert main.run(["run", "--no-such", "prog"], {}) == 2


def test_without_a_name_each_node_uses_its_own(became: dict[str, Any]) -> None:
    main.run(["run", "prog"], {})
    assert (became["identity"], became["each"]) == (None, True)


def test_a_wrong_command_line_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["run", "--as", "robot", "prog"], {}) == 1
    assert main.run(["run"], {}) == 2
    said = capsys.readouterr().err
    assert "rossec: error: 'robot' is not an absolute ROS name" in said


def test_the_program_runs_with_loopback_in_its_environment(tmp_path: Path) -> None:
    done = started(
        ["run", "--", "sh", "-c", "echo $ROS_MASTER_URI $ROS_IP; exit 7"],
        ROSSEC_HOME=str(tmp_path),
        ROS_MASTER_URI="http://far:11311",
    )
    assert done.returncode == 7
    assert done.stdout.startswith("http://127.0.0.1:")
    assert done.stdout.endswith(" 127.0.0.1\n")
    assert done.stderr == ""


def test_the_program_has_the_limit_it_would_have_had(tmp_path: Path) -> None:
    inside = f"exec {BIN} run -- sh -c 'ulimit -Sn; grep \"open files\" /proc/$PPID/limits'"
    done = subprocess.run(
        ["sh", "-c", f"ulimit -Sn 300; {inside}"],
        text=True,
        capture_output=True,
        timeout=30,
        env={**os.environ, "ROSSEC_HOME": str(tmp_path)},
        check=True,
    )
    limit, ours = done.stdout.splitlines()
    assert limit == "300"
    assert int(ours.split()[3]) > 300


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["run", "--", "/no/such"], 127, "rossec: error: /no/such: there is no such program"),
        (["run", "--as", "/robot", "--", "true"], 1, "rossec: error: /robot has no ca.pem"),
    ],
)
def test_a_refusal_has_a_hint(tmp_path: Path, arguments: list[str], code: int, words: str) -> None:
    done = started(arguments, ROSSEC_HOME=str(tmp_path))
    assert done.returncode == code
    assert done.stderr.startswith(words)
    assert "rossec: hint: " in done.stderr
    assert "Traceback" not in done.stderr


def test_ctrl_c_during_discovery_ends_silently(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/robot")
    # A shell lets what it runs in the background ignore Ctrl-C, and so these tests.
    heeding = ["env", "--default-signal=INT"]
    with subprocess.Popen(
        [*heeding, BIN, "run", "--", "true"],
        text=True,
        stderr=subprocess.PIPE,
        env={**os.environ, "ROSSEC_HOME": str(site.root), "ROS_MASTER_URI": "discover:"},
    ) as running:
        command = Path(f"/proc/{running.pid}/cmdline")
        end = time.monotonic() + 30
        while b"rossec.sidecar" not in command.read_bytes():
            assert time.monotonic() < end
        running.send_signal(signal.SIGINT)
        assert running.wait(30) == -signal.SIGINT
        assert running.stderr is not None
        assert running.stderr.read() == ""
