"""The program `rossec`: its exit code, and Ctrl-C while it begins and ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import rossec.__main__
from rossec.cli import main as command_line

BEGIN = [sys.executable, "-I", "-X", "importtime", "-m", "rossec", "--help"]


def test_it_exits_with_the_code_of_the_command(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.argv", ["rossec", "ca", "show"])
    monkeypatch.setenv("ROSSEC_HOME", str(tmp_path))
    before = signal.getsignal(signal.SIGINT)
    try:
        with pytest.raises(SystemExit) as caught:
            rossec.__main__.main()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGINT, before)
    assert caught.value.code == 1


def test_ctrl_c_that_no_command_took_is_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        raise KeyboardInterrupt

    monkeypatch.setattr(command_line, "main", interrupted)
    before = signal.getsignal(signal.SIGINT)
    try:
        with pytest.raises(SystemExit) as caught:
            rossec.__main__.main()
    finally:
        signal.signal(signal.SIGINT, before)
    assert caught.value.code == 130


@pytest.mark.parametrize("module", ["rossec.__main__", "click.core", "rossec.cli.main"])
def test_ctrl_c_while_modules_are_imported_is_quiet(module: str) -> None:
    """`-X importtime` tells how far it is."""
    with subprocess.Popen(BEGIN, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if line.split("|")[-1].strip() == ("signal" if module.endswith("__main__") else module):
                break
        time.sleep(0.001)
        os.kill(run.pid, signal.SIGINT)
        out, err = run.communicate(timeout=60)
    assert "Traceback" not in out + err
    assert "KeyboardInterrupt" not in out + err


def test_an_ignored_ctrl_c_stays_ignored() -> None:
    """As `nohup` and shells do for what runs in the background."""
    asked = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); import sys;"
    asked += "sys.argv[1:] = ['--help']; from rossec.__main__ import main\n"
    asked += "try: main()\nexcept SystemExit: print(signal.getsignal(signal.SIGINT).name)"
    done = subprocess.run([sys.executable, "-I", "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("SIG_IGN\n")


@pytest.mark.parametrize(
    "environ",
    [
        {"_ROSSEC_COMPLETE": "bash_complete"},  # no line
        {"_ROSSEC_COMPLETE": "bash_complete", "COMP_WORDS": "x", "COMP_CWORD": "y"},
        {"_ROSSEC_COMPLETE": "bash_complete", "COMP_LINE": "rossec node show ", "ROSSEC_HOME": "x"},
        {"_ROSSEC_COMPLETE": "", "COMP_LINE": "rossec "},
    ],
)
def test_tab_is_quiet_whatever_happens(environ: dict[str, str]) -> None:
    command = [sys.executable, "-I", "-m", "rossec"]
    done = subprocess.run(command, env={**os.environ, **environ}, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_tab_is_answered() -> None:
    environ = {**os.environ, "_ROSSEC_COMPLETE": "bash_complete", "COMP_LINE": "rossec ca loc"}
    command = [sys.executable, "-I", "-m", "rossec"]
    done = subprocess.run(command, env=environ, capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"plain,lock\n", b"")
