from pathlib import Path

import pytest

from tests.support.commands import Shell, refused


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(tmp_path / "home", capsys)


def test_without_a_running_master_there_is_no_answer(shell: Shell) -> None:
    for verb in ("status", "stop"):
        refused(shell("master", verb), "the master does not answer", "--admin")
