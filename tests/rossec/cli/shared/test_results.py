"""`--json` of commands that act: one document on stdout, everything for people on stderr."""

import json

import click
import pytest

from ca.errors import HintedError, StoreError
from rossec.cli.shared.context import confirm
from rossec.cli.shared.options import Batch, add_entry, json_result, recorded_in
from rossec.errors import NotDelivered
from rossec.terminal import record, say, say_secret


def run(work: object, *words: str, secret: bool = False) -> None:
    @click.command()
    @json_result(secret=secret)
    def command() -> None:
        """Do it."""
        assert callable(work)
        work()

    command.main(list(words), standalone_mode=False)


def test_without_it_facts_are_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        record(name="/robot")
        add_entry("results", {"ok": True})
        say("done")

    run(work)
    assert capsys.readouterr().out == "done\n"


def test_with_it_stdout_holds_one_document(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        record(name="/robot", expires=7)
        say("for people")
        with recorded_in(entry := {"ok": True}):
            record(file="x")
        add_entry("results", entry)

    run(work, "--json")
    said = capsys.readouterr()
    assert json.loads(said.out) == {"name": "/robot", "expires": 7, "results": [{"ok": True, "file": "x"}]}
    assert said.out.count("\n") == 1
    assert said.err == "for people\n"


def test_nothing_of_one_command_is_left_for_the_next(capsys: pytest.CaptureFixture[str]) -> None:
    run(lambda: record(first=1), "--json")
    run(lambda: record(second=2), "--json")
    run(lambda: say("plain"))
    assert capsys.readouterr().out.splitlines() == ['{"first": 1}', '{"second": 2}', "plain"]


def test_what_was_done_before_a_refusal_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        record(keys=1, published=False)
        raise NotDelivered("the master is away", "rossec ca publish")

    with pytest.raises(NotDelivered):
        run(work, "--json")
    assert json.loads(capsys.readouterr().out) == {
        "keys": 1,
        "published": False,
        "error": "the master is away",
        "hint": "rossec ca publish",
    }


@pytest.mark.parametrize("error", [StoreError("no", "so"), EOFError(), OSError("full")])
def test_if_nothing_was_done_there_is_no_document(
    error: BaseException, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> None:
        if not isinstance(error, HintedError):
            record(begun=True)
        raise error

    with pytest.raises((type(error), click.Abort)):
        run(work, "--json")
    assert capsys.readouterr().out == ""
    say("after")
    assert capsys.readouterr().out == "after\n"


def test_what_a_question_is_about_can_be_read(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def answer(question: str, **_: object) -> bool:
        asked.append(capsys.readouterr().err)
        return True

    monkeypatch.setattr(click, "confirm", answer)

    def work() -> None:
        say("fingerprint 12ab")
        confirm("sign it?", yes=False)
        record(signed=True)

    run(work, "--json")
    assert asked == ["fingerprint 12ab\n"]
    assert capsys.readouterr().out == '{"signed": true}\n'


def test_a_secret_is_in_the_document_and_nowhere_else(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        record(code="S3CRET")
        say_secret("S3CRET")

    run(work, "--json", secret=True)
    said = capsys.readouterr()
    assert said.out == '{"code": "S3CRET"}\n'
    assert said.err == ""


def test_each_of_several_has_an_entry(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        batch = Batch(3, "name")
        for name in ("/a", "/b", "/c"):
            with batch.item(name, last=False):
                if name == "/b":
                    raise StoreError("is unknown", "see there")
        with batch.item("/a"):
            record(list=3)
        raise NotDelivered("the master is away")

    with pytest.raises(NotDelivered):
        run(work, "--json")
    said = capsys.readouterr()
    assert json.loads(said.out) == {
        "results": [
            {"name": "/a", "ok": True, "list": 3},
            {"name": "/b", "ok": False, "error": "is unknown", "hint": "see there"},
            {"name": "/c", "ok": False},
        ],
        "error": "the master is away",
        "hint": "",
    }
    assert said.err == "rossec: error: /b: is unknown\nrossec: hint: see there\n"


def test_the_refusal_of_a_single_one_is_in_its_entry(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        with Batch(1, "id").item("12"):
            raise StoreError("is unknown")

    with pytest.raises(StoreError):
        run(work, "--json")
    (entry,) = json.loads(capsys.readouterr().out)["results"]
    assert entry == {"id": "12", "ok": False, "error": "is unknown", "hint": ""}
