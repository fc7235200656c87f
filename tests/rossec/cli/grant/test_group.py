import click
import pytest

from rossec.cli.grant.group import grant
from tests.rossec.cli.tables import check_table


@pytest.mark.parametrize("group", [grant], ids=lambda group: group.name)
def test_each_listed_command_exists_and_has_this_help_line(group: click.Command) -> None:
    check_table(group)
