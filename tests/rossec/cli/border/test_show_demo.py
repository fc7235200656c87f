"""`rossec border --demo`."""

from pathlib import Path

import pytest

from rossec.cli import demo
from rossec.demo import steps
from rossec.demo.environment import DemoEnvironment
from tests.support.commands import Shell, refused


def test_it_has_a_home_of_its_own_and_leaves_nothing(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    roots: list[Path] = []

    async def run_steps(demo: DemoEnvironment) -> None:
        assert demo.root.is_dir()
        roots.append(demo.root)
        await demo.command("border", "--help", quiet=True)

    monkeypatch.setattr(steps, "run_border_steps", run_steps)
    said = empty("border", "--demo")
    assert said.code == 0, said
    assert said.out == "    $ rossec border --help\n"
    assert not roots[0].exists()


def test_it_takes_no_other_option(empty: Shell) -> None:
    refused(empty("border", "--demo", "--port", "5"), "a home of its own", "leave the other")
    refused(empty("border", "--demo", "list"), "options of the router", code=2)


def test_it_needs_the_extra(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "_LIBRARIES", ("aiocoap_is_not_here",))
    refused(empty("border", "--demo"), "not installed", "rossec[constrained]")
