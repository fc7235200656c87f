"""Answers, and the scripts in the shells themselves (zsh and fish where they are installed)."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from rossec.cli import main
from rossec.cli.completion.shells import script

ROSSEC = str(Path(sys.executable).with_name("rossec"))


@pytest.fixture
def home(tmp_path: Path) -> Path:
    path = tmp_path / "home"
    for name in ("robot1.camera", "robot1.lidar", "robot2"):
        (path / "nodes" / name).mkdir(parents=True)
    path.chmod(0o700)
    return path


def answer(home: Path, shell: str, line: str) -> list[str]:
    environ = {"ROSSEC_HOME": str(home), "_ROSSEC_COMPLETE": f"{shell}_complete", "COMP_LINE": line}
    return main.complete(environ).splitlines()


def test_commands_names_and_options_are_completed(home: Path) -> None:
    assert answer(home, "bash", "rossec ca inv") == ["plain,invitations", "plain,invite"]
    assert answer(home, "bash", "rossec node show /robot1/l") == ["plain,/robot1/lidar"]
    assert answer(home, "bash", "rossec node show --js") == ["plain,--json"]
    assert answer(home, "bash", "rossec topic hz --as=/robot2") == ["plain,/robot2"]
    assert answer(home, "bash", "rossec ca sign ./") == ["file,./"]
    described = answer(home, "zsh", "rossec ca invite --use")
    assert [line.split("\t")[:2] for line in described] == [["plain", "--uses"]]
    assert len(described[0].split("\t")) == 3
    assert answer(home, "fish", "rossec node show /robot2") == ["plain\t/robot2"]


def test_bash_gets_what_is_behind_a_colon(home: Path) -> None:
    (home / "ca").mkdir(mode=0o700)
    (home / "ca" / "policy.yaml").write_text("rules: [{node: hospital:/cart}]\n")
    line = "rossec grant sign hospital:"
    assert answer(home, "bash", line) == ["plain,/cart"]
    assert answer(home, "zsh", line) == ["plain\thospital:/cart"]


@pytest.mark.parametrize(
    "line", ["", " ", "rossec", "rossec 'a", 'rossec "', "rossec \\", "rossec ca \x00", "x y z"]
)
def test_any_line_has_an_answer(home: Path, line: str) -> None:
    assert isinstance(answer(home, "bash", line), list)


def test_an_unknown_shell_gets_nothing(home: Path) -> None:
    assert answer(home, "tcsh", "rossec ca ") == []
    assert main.complete({"_ROSSEC_COMPLETE": "bash_source"}) == ""


def test_scripts_of_click_are_answered_too(home: Path) -> None:
    environ = {
        "ROSSEC_HOME": str(home),
        "_ROSSEC_COMPLETE": "bash_complete",
        "COMP_WORDS": "rossec\nnode\nshow\n/robot2",
        "COMP_CWORD": "3",
    }
    assert main.complete(environ) == "plain,/robot2\n"
    assert main.complete({**environ, "COMP_CWORD": "1"}).startswith("plain,node")


def typed(shell: list[str], text: str, home: Path, more: Mapping[str, str] | None = None) -> str:
    """What a shell prints that runs `text`."""
    if shutil.which(shell[0]) is None:
        pytest.skip(f"NOT RUN: no {shell[0]} on this machine")
    environ = {**os.environ, "ROSSEC_HOME": str(home), "HOME": str(home), **(more or {})}
    done = subprocess.run(
        shell, input=text, env=environ, text=True, capture_output=True, timeout=60, check=False
    )
    assert done.stderr == ""
    return done.stdout


BASH_TAB = """
COMP_LINE={line!r}; COMP_POINT=${{#COMP_LINE}}; COMP_WORDS=($COMP_LINE); COMP_CWORD=1
_rossec_completion rossec; printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def test_in_bash(home: Path) -> None:
    text = script("bash", ROSSEC) + BASH_TAB.format(line="rossec node show /robot1")
    found = typed(["bash", "--norc"], text, home)
    assert found.splitlines() == ["/robot1/camera", "/robot1/lidar"]


def test_in_fish(home: Path) -> None:
    text = script("fish", ROSSEC) + "complete --do-complete 'rossec node show /robot1'\n"
    found = typed(["fish", "--no-config"], text, home)
    assert found.splitlines() == ["/robot1/camera", "/robot1/lidar"]
    text = script("fish", ROSSEC) + "complete --do-complete 'rossec ca unl'\n"
    assert typed(["fish", "--no-config"], text, home).startswith("unlock\tGive the running")


ZSH_TAB = """
autoload -U compinit && compinit -D -u
words=(rossec node show /robot1); CURRENT=4
compadd() {{ print -rl -- "${{plain[@]}}" }}
eval "$(cat {script})"
_rossec_completion
"""


def test_in_zsh(home: Path, tmp_path: Path) -> None:
    (tmp_path / "script").write_text(script("zsh", ROSSEC))
    found = typed(["zsh", "-f"], ZSH_TAB.format(script=tmp_path / "script"), home)
    assert found.splitlines() == ["/robot1/camera", "/robot1/lidar"]
