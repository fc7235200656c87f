from rossec.cli.federation.group import federation
from tests.rossec.cli.tables import check_table


def test_each_listed_command_exists_and_has_this_help_line() -> None:
    check_table(federation)
