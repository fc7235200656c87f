from pathlib import Path

import pytest

from rossec.demo import steps
from rossec.demo.environment import DemoEnvironment
from tests.support.commands import Shell, refused


def test_a_kept_demo_prints_how_to_go_on(
    empty: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def run_steps(demo: DemoEnvironment) -> None:
        await demo.command("ca", "--help", quiet=True)

    monkeypatch.setattr(steps, "run_steps", run_steps)
    there = tmp_path / "there"
    said = empty("demo", "--keep", str(there))
    assert said.code == 0, said
    assert f"export ROSSEC_HOME={there}" in said.out
    assert f"rossec ca serve --unlock-for 0 --passphrase-file {there}/passphrase\n" in said.out
    assert "    rossec console\n" in said.out
    assert there.stat().st_mode & 0o777 == 0o700


def test_a_directory_that_exists_is_not_used(empty: Shell, tmp_path: Path) -> None:
    refused(empty("demo", "--keep", str(tmp_path)), "exists", "does not exist")


def test_without_keep_nothing_is_left(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    roots: list[Path] = []

    async def run_steps(demo: DemoEnvironment) -> None:
        roots.append(demo.root)

    monkeypatch.setattr(steps, "run_steps", run_steps)
    said = empty("demo")
    assert said.code == 0
    assert said.out.endswith("in a browser: rossec console --demo\n")
    assert not roots[0].exists()
