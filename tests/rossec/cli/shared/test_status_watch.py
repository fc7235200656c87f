"""The status of a service, shown once or whenever it changes."""

from typing import Any

import pytest

from rossec.cli import status


class Ended(Exception):
    """The service has ended."""


def shown(
    capsys: pytest.CaptureFixture[str], *answers: str, as_json: bool = False, watch: bool = False
) -> tuple[str, str]:
    left = list(answers)

    def ask() -> dict[str, Any]:
        if not left:
            raise Ended
        return {"is": left.pop(0)}

    def missing(answer: dict[str, Any]) -> str:
        return "nothing" if answer["is"] == "" else ""

    try:
        status.show_status(
            ask, lambda answer: [f"it is {answer['is']}"], missing, as_json=as_json, watch=watch
        )
    except Ended:
        assert watch
    out, err = capsys.readouterr()
    return out, err


def test_it_is_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(capsys, "a\x1b", "b") == ("it is a\\u001b\n", "")
    assert shown(capsys, "") == ("it is \n", "rossec: nothing\n")
    assert shown(capsys, "", as_json=True) == ('{"is": ""}\n', "")


def test_it_is_shown_again_when_it_changes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "PERIOD", 0)
    assert shown(capsys, "a", "a", "", "", "a", watch=True) == (
        "it is a\nit is \nit is a\n",
        "rossec: nothing\n",
    )
    assert shown(capsys, "a", "a", as_json=True, watch=True)[0] == '{"is": "a"}\n' * 2
