from pathlib import Path

import pytest

from rossec import terminal


def test_results_go_to_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.say("enrolled /robot")
    terminal.say_json({"b": 1, "a": [2]})
    assert capsys.readouterr() == ('enrolled /robot\n{"a": [2], "b": 1}\n', "")


def test_errors_and_notes_go_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.fail("no such node", "see: rossec node show")
    terminal.fail("no hint here")
    terminal.note("waiting")
    assert capsys.readouterr().err == (
        "rossec: error: no such node\nrossec: hint: see: rossec node show\n"
        "rossec: error: no hint here\nrossec: waiting\n"
    )


@pytest.mark.parametrize(
    ("hostile", "shown"),
    [
        ("a\nb", "a\\u000ab"),
        ("\x1b[31mred", "\\u001b[31mred"),
        ("abc\u202edef", "abc\\u202edef"),
        ("caf\u00e9", "caf\u00e9"),
    ],
)
def test_names_of_peers_cannot_control_the_terminal(hostile: str, shown: str) -> None:
    assert terminal.printable(hostile) == shown


def test_what_a_peer_refused_begins_with_the_name_of_the_program_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    terminal.fail("rossec: /other needs the right subscribe on /robot/pose")
    said = capsys.readouterr().err
    assert said == "rossec: error: /other needs the right subscribe on /robot/pose\n"


def test_what_is_secret_is_printed_to_a_file_of_this_user_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "home.seat"
    path.touch(mode=0o644)
    with path.open("w") as file:
        monkeypatch.setattr("sys.stdout", file)
        terminal.say_secret("a password")
    assert path.read_text() == "a password\n"
    assert path.stat().st_mode & 0o777 == 0o600


def test_what_is_secret_is_printed_to_a_pipe_as_it_is(capfd: pytest.CaptureFixture[str]) -> None:
    terminal.say_secret("a password")
    assert capfd.readouterr().out == "a password\n"


def test_a_file_that_cannot_be_closed_to_others_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(_file: int, _mode: int) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.fchmod", refuse)
    with (tmp_path / "home.seat").open("w") as file:
        monkeypatch.setattr("sys.stdout", file)
        terminal.say_secret("a password")
    assert "others may read the file: Operation not permitted" in capsys.readouterr().err


def test_facts_are_kept_where_a_document_is_made(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.record(lost=True)  # nobody asked for a document
    facts: dict[str, object] = {}
    token = terminal.FACTS.set(facts)
    try:
        terminal.record(name="/robot")
        terminal.record(expires=7)
        terminal.say("for people")
        terminal.say_secret("S3CRET")
    finally:
        terminal.FACTS.reset(token)
    assert facts == {"name": "/robot", "expires": 7}
    assert capsys.readouterr() == ("", "for people\n")
    terminal.say_secret("S3CRET")
    assert capsys.readouterr().out == "S3CRET\n"
    assert terminal.to_json({"b": 1, "a": None}) == '{"a": null, "b": 1}'


def test_pictures_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    picture = "\x1b[7m  \x1b[0m"
    terminal.say_picture(picture)
    terminal.say_picture(picture, is_secret=True)
    terminal.note_picture(picture)
    assert capsys.readouterr() == (f"{picture}\n{picture}\n", f"{picture}\n")


def test_with_a_document_a_picture_goes_to_stderr_and_a_secret_one_nowhere(
    capsys: pytest.CaptureFixture[str],
) -> None:
    token = terminal.FACTS.set({})
    try:
        terminal.say_picture("blocks")
        terminal.say_picture("secret", is_secret=True)
    finally:
        terminal.FACTS.reset(token)
    assert capsys.readouterr() == ("", "blocks\n")


def test_what_is_temporary_is_taken_away_before_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[str] = []
    monkeypatch.setattr(terminal, "TEMPORARY", [lambda: taken.append("progress")])
    terminal.note("done")
    assert taken == ["progress"]
    assert capsys.readouterr().err == "rossec: done\n"
    assert terminal.state("ok") == "ok"
