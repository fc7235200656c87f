from typing import Any

import click
import pytest

from rossec.cli.ca import sign


def parsed(*arguments: str, multiple: bool = False) -> Any:
    @click.command()
    @sign.identity_lifetime
    @sign.replace_key(multiple=multiple)
    @sign.anonymous
    def command(**values: object) -> dict[str, object]:
        return values

    return command.main(list(arguments), standalone_mode=False)


def test_an_identity_lasts_30_days_by_default() -> None:
    assert parsed() == {"lifetime": 30 * 86400, "replaced": None, "anonymous": False}


def test_each_option_is_passed_on() -> None:
    words = ("--for", "366d", "--anonymous", "--replace-key", "/a")
    assert parsed(*words) == {"lifetime": 366 * 86400, "replaced": "/a", "anonymous": True}
    several = parsed("--replace-key", "/a", "--replace-key", "/b", multiple=True)
    assert several["replaced"] == ("/a", "/b")


def test_a_lifetime_above_a_year_is_refused() -> None:
    with pytest.raises(click.BadParameter, match="at most 366d"):
        parsed("--for", "367d")
