import os
import socket
import subprocess
from pathlib import Path
from typing import Any

import pytest

from rossec.cli import main
from tests.rossec.cli.node.processes import BIN, started


def test_the_options_of_sidecar_reach_it(became: dict[str, Any]) -> None:
    main.run(["sidecar", "--user", "root", "--user", "4711", "-p", "4000"], {})
    assert became["users"] == [0, 4711]
    assert became["port"] == 4000
    assert became["command"] == []


def test_an_unknown_user_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["sidecar", "--user", "no-such-user"], {}) == 2
    assert main.run(["sidecar", "--user", "4294967295"], {}) == 2
    assert "no user 'no-such-user' on this host" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("http://far:11311", ["rossec: error: cannot listen at 127.0.0.1 port", "--port"]),
        ("http://localhost:{}", ["is the sidecar's own address", "where the secured master is"]),
    ],
)
def test_a_port_that_the_sidecar_cannot_use_is_refused(tmp_path: Path, uri: str, words: list[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as roscore:
        port = roscore.getsockname()[1]
        if "far" not in uri:
            roscore.close()
        done = started(
            ["sidecar", "-p", str(port)], ROSSEC_HOME=str(tmp_path), ROS_MASTER_URI=uri.format(port)
        )
    assert done.returncode == 1
    assert all(word in done.stderr for word in words), done.stderr


def test_a_service_ends_with_a_signal(tmp_path: Path) -> None:
    with subprocess.Popen(
        [BIN, "sidecar", "-p", "0"],
        text=True,
        stdout=subprocess.PIPE,
        env={**os.environ, "ROSSEC_HOME": str(tmp_path)},
    ) as running:
        assert running.stdout is not None
        assert running.stdout.readline().startswith("sidecar at http://127.0.0.1:")
        running.terminate()
        assert running.wait(20) == 0
