import pytest

from rossec.cli import voice


def test_results_go_to_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    voice.say("enrolled /robot")
    voice.say_json({"b": 1, "a": [2]})
    assert capsys.readouterr() == ('enrolled /robot\n{"a": [2], "b": 1}\n', "")


def test_errors_and_notes_go_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    voice.fail("no such node", "see: rossec node show")
    voice.fail("no hint here")
    voice.note("waiting")
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
def test_names_of_strangers_cannot_steer_the_terminal(hostile: str, shown: str) -> None:
    assert voice.printable(hostile) == shown
