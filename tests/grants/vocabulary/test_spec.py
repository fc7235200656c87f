"""The specification has the tables of the code, and every word and level."""

from grants.vocabulary.contents import LEVELS
from tools.vocabulary import SPEC, TABLES, written

TEXT = SPEC.read_text()


def test_the_tables_of_the_specification_are_those_of_the_code() -> None:
    assert written(TEXT) == TEXT, "run: python -m tools.vocabulary"
    assert all(table() in TEXT for table in TABLES.values())


def test_the_specification_names_every_level() -> None:
    for word, levels in LEVELS.items():
        [row] = [line for line in TEXT.splitlines() if line.startswith(f"| {word} | ")][:1]
        assert row.endswith(f" | {', '.join(levels)} |")
