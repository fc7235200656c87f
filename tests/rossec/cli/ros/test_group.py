import click
import pytest

from rossec.cli.ros.group import param, service, topic
from tests.rossec.cli.tables import check_table


@pytest.mark.parametrize("group", [param, service, topic], ids=lambda group: group.name)
def test_each_listed_command_exists_and_has_this_help_line(group: click.Command) -> None:
    check_table(group)
