from rossec.cli.domain.group import domain
from tests.rossec.cli.tables import check_table
from tests.support.commands import Shell, refused


def test_each_listed_command_exists_and_has_this_help_line() -> None:
    check_table(domain)


def test_without_an_authority_there_are_no_domains(empty: Shell) -> None:
    refused(empty("domain", "list"), "there is no authority", "rossec ca init")
    assert "Trust other domains" in empty("domain", "--help").out
