"""The group `rossec border`."""

import sys

import click
import pytest

from rossec.cli import border, demo
from tests.support.commands import Shell, refused


def test_options_of_the_router_do_not_stand_before_a_verb(empty: Shell) -> None:
    said = empty("border", "--port", "1", "list")
    refused(said, "options of the router do not stand before a verb", code=2)


def test_without_a_verb_it_runs(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[object] = []

    def run(_environment: object, *arguments: object, as_json: bool) -> None:
        given.append((*arguments, as_json))

    monkeypatch.setattr(border, "run", run)
    assert empty("border", "--as", "/attic", "--listen", "::1", "--json").code == 0
    assert given == [("/attic", "::1", 5683, True)]


def test_the_demonstration(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[click.Context] = []
    monkeypatch.setattr(demo, "show_border_demo", shown.append)
    assert empty("border", "--demo").code == 0
    assert len(shown) == 1


def test_without_the_extra(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rossec.border.handshakes", None)
    refused(empty("border"), "CoAP for things is not installed", "rossec[constrained]")
