import click
import pytest

from rossec.cli.policy.group import policy, privacy
from tests.rossec.cli.tables import check_table
from tests.support.commands import Shell, refused


@pytest.mark.parametrize("group", [policy, privacy], ids=lambda group: group.name)
def test_each_listed_command_exists_and_has_this_help_line(group: click.Command) -> None:
    check_table(group)


def test_privacy_is_a_report_and_a_group(shell: Shell) -> None:
    refused(shell("privacy", "--node", "/a"), "policy")
    refused(shell("privacy", "opt-out", "camera"), "camera")
