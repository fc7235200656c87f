import time
from pathlib import Path
from typing import Any

import click
import pytest

from ca.errors import PathRefused
from rossec.cli.shared import context
from rossec.errors import ConfigurationError


@pytest.mark.parametrize(
    ("text", "seconds"), [("30s", 30), ("15m", 900), ("8h", 28800), ("7d", 604800), ("4w", 2419200), (5, 5)]
)
def test_a_duration_is_parsed_to_seconds(text: Any, seconds: int) -> None:
    assert context.Duration().convert(text, None, None) == seconds


def test_a_duration_has_its_limit() -> None:
    assert context.Duration(14).convert("2w", None, None) == 14 * 86400
    with pytest.raises(click.BadParameter, match="15d is too long; at most 14d are allowed"):
        context.Duration(14).convert("15d", None, None)


@pytest.mark.parametrize("text", ["", "7", "d", "0d", "-1d", "1.5h", "1 h", "1y", "\u0661d", "7D"])
def test_an_invalid_duration_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="write 30s, 15m, 8h, 7d or 4w"):
        context.Duration().convert(text, None, None)


@pytest.mark.parametrize(
    ("end", "raised"), [(KeyboardInterrupt, KeyboardInterrupt), (EOFError, ConfigurationError)]
)
def test_ctrl_c_at_a_question_is_raised(
    monkeypatch: pytest.MonkeyPatch, end: type[BaseException], raised: type[BaseException]
) -> None:
    def ended(*_: object, **__: object) -> str:
        raise end

    monkeypatch.setattr("builtins.input", ended)
    monkeypatch.setattr("click.termui.visible_prompt_func", ended)
    with pytest.raises(raised):
        context.confirm("really?", yes=False)


@pytest.mark.parametrize(("text", "seconds"), [("0", 0), ("15m", 900), ("7d", 7 * 86400)])
def test_a_time_to_unlock_may_have_no_end(text: str, seconds: int) -> None:
    assert context.UnlockTime(7 * 86400).convert(text, None, None) == seconds


@pytest.mark.parametrize("text", ["8d", "0m", "00", "-1", ""])
def test_a_time_to_unlock_is_bounded(text: str) -> None:
    with pytest.raises(click.BadParameter):
        context.UnlockTime(7 * 86400).convert(text, None, None)


def test_an_answer_is_asked_for_unless_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["y", "n", ""])
    monkeypatch.setattr("click.termui.visible_prompt_func", lambda _: next(answers))
    context.confirm("really?", yes=True)
    context.confirm("really?", yes=False)
    for _ in "no", "":
        with pytest.raises(ConfigurationError, match="nothing was done"):
            context.confirm("really?", yes=False)


def test_the_home_of_a_command_is_its_users_alone(tmp_path: Path) -> None:
    environment = context.Environment({"ROSSEC_HOME": str(tmp_path)})
    assert environment.home == tmp_path
    tmp_path.chmod(0o777)
    with pytest.raises(PathRefused):
        _ = environment.home
    with pytest.raises(ConfigurationError):
        _ = context.Environment({"ROSSEC_HOME": "here"}).home
    assert abs(context.now() - time.time()) < 60
