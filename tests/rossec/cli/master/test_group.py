from typing import Any

import pytest

from rossec.cli import master
from tests.support.commands import Shell


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ((), {}),
        (("--port", "0"), {"port": 0}),
        (("--admin", "--announce", "--log", "json"), {"admin": True, "announce": True, "log": "json"}),
    ],
)
def test_options_that_are_not_given_leave_the_configuration(
    empty: Shell, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], given: dict[str, Any]
) -> None:
    ran = []
    monkeypatch.setattr(master, "run", lambda *words, **options: ran.append((words, options)))
    assert empty("master", *words).code == 0
    ((arguments, options),) = ran
    assert arguments[1:] == (None, given, None)
    assert options == {
        "renew_identities": False,
        "post_quantum": None,
        "as_json": False,
        "name": "/master",
        "follow_announced": False,
    }


def test_another_master_of_the_domain(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[dict[str, Any]] = []
    monkeypatch.setattr(master, "run", lambda *_, **options: ran.append(options))
    assert empty("master", "--name", "/master/kitchen", "--follow-announced").code == 0
    assert (ran[0]["name"], ran[0]["follow_announced"]) == ("/master/kitchen", True)
    refused = empty("master", "--name", "/robot")
    assert (refused.code, len(ran)) == (1, 1)
    assert "'/robot' is not the name of a master" in refused.err


def test_a_verb_runs_no_master(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(master, "run", lambda *_, **__: pytest.fail("it runs"))
    assert empty("master", "status").code == 1
