from rossec.cli.router.group import router
from tests.rossec.cli.tables import check_table


def test_each_verb_exists_and_has_this_help_line() -> None:
    check_table(router)
