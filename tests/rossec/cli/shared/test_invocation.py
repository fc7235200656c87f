import os

import click
import pytest

from rossec.cli.shared import context
from rossec.errors import ConfigurationError, NotDelivered


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigurationError("no", "do"), 1),
        (NotDelivered("no", "do"), 3),
        (click.ClickException("Something."), 1),
        (KeyboardInterrupt(), 130),
        (EOFError(), 130),
        (FileNotFoundError(2, "No such file", "x"), 1),
        (OSError("strange"), 1),
    ],
)
def test_every_error_has_its_exit_code(error: BaseException, code: int) -> None:
    @click.command()
    def program() -> None:
        raise error

    assert context.run(program, [], os.environ) == code


def test_click_errors_are_printed_as_error_and_hint(capsys: pytest.CaptureFixture[str]) -> None:
    @click.command()
    @click.argument("name")
    def program(name: str) -> None:
        """Take one name."""

    assert context.run(program, [], {}) == 2
    said = capsys.readouterr().err
    assert said == "rossec: error: missing argument 'NAME'\nrossec: hint: see: rossec --help\n"
    assert context.run(program, ["x"], {}) == 0
