import click
import pytest

from rossec.cli.ca.group import ca, intermediate, invitations, log
from tests.rossec.cli.tables import check_table
from tests.support.commands import Shell, refused


@pytest.mark.parametrize(
    "group", [ca, intermediate, invitations, log], ids=lambda group: group.name
)
def test_each_listed_command_exists_and_has_this_help_line(group: click.Command) -> None:
    check_table(group)


def test_the_log_is_shown_by_its_group_and_checked_by_a_verb(shell: Shell) -> None:
    lines = shell("ca", "log").out.splitlines()
    assert len(lines) > 1
    assert shell("ca", "log", "--last", "1").out.splitlines() == lines[-1:]
    assert shell("ca", "log", "verify").out.splitlines() != lines


def test_the_invitations_are_shown_by_their_group_and_ended_by_a_verb(shell: Shell) -> None:
    assert shell("ca", "invitations").out == "no open invitations\n"
    assert shell("ca", "invitations", "--all").out == "no invitations\n"
    refused(shell("ca", "invitations", "revoke", "abc"), "no invitation")
