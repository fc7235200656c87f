"""The group `rossec namespace`."""

from rossec.cli.namespace.group import namespace
from tests.rossec.cli.tables import check_table


def test_each_verb_exists_and_has_this_help_line() -> None:
    check_table(namespace)
