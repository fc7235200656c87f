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
