import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import Shell, refused

ROSSEC = Path(sys.executable).with_name("rossec")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_is_printed(empty: Shell, shell: str) -> None:
    said = empty("completion", shell)
    assert (said.code, said.err) == (0, "")
    assert f"_ROSSEC_COMPLETE {shell}_complete".split()[1] in said.out


def test_another_shell_is_refused(empty: Shell) -> None:
    refused(empty("completion", "tcsh"), "'tcsh' is not one of", code=2)
    refused(empty("completion"), "missing argument", "see: rossec completion --help", code=2)


def test_tab_runs_the_program_that_printed_the_script(tmp_path: Path) -> None:
    link = tmp_path / "a $(b)" / "rossec"
    link.parent.mkdir()
    link.symlink_to(ROSSEC)
    done = subprocess.run([link, "completion", "bash"], capture_output=True, text=True, check=True)
    assert f"'{link}'" in done.stdout


def test_a_module_is_run_as_the_program_on_the_path(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["/x/rossec/__main__.py"])
    assert "bash_complete rossec <" in empty("completion", "bash").out
    monkeypatch.setattr("sys.argv", ["/nowhere/rossec"])
    assert "bash_complete rossec <" in empty("completion", "bash").out


def test_help_says_how_it_is_installed(empty: Shell) -> None:
    text = empty("completion", "--help").out
    assert 'eval "$(rossec completion bash)"' in text
    assert "~/.config/fish/completions/rossec.fish" in text
