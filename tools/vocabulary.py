"""Write the tables of `docs/spec/vocabulary.md` again, after a type or a level has changed."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from grants.vocabulary.contents import MEANINGS, TYPES, Content, DataWord
from grants.vocabulary.levels import LEVEL_TABLE, Level, Treatment

SPEC: Final = Path(__file__).parents[1] / "docs" / "spec" / "vocabulary.md"
_BEGIN, _END = "<!-- {}: python -m tools.vocabulary -->\n", "<!-- end -->\n"


def _words(words: Iterable[DataWord]) -> str:
    return ", ".join(word for word in DataWord if word in set(words))


def _treatment(treatment: Treatment | None) -> str:
    if treatment is None:
        return "as it is"
    return " ".join([treatment.operator, *(f"{name} {v}" for name, v in treatment.parameters)])


def _limit(level: Level) -> str:
    if level.slot is not None:
        outdoors = "" if level.outdoors is None else f", of {level.outdoors} s outdoors"
        return f"slot of {level.slot} s{outdoors}"
    return "" if level.rate is None else f"1 in {1 / level.rate:.0f} s"


def contents() -> str:
    """What each content tells."""
    rows = ["| content | own word | tells as well | may show |", "|---|---|---|---|"]
    for content, meaning in MEANINGS.items():
        own = meaning.own or ""
        tells = _words(meaning.tells - {meaning.own} if meaning.own else meaning.tells)
        rows.append(f"| {content} | {own} | {tells} | {_words(meaning.hints)} |")
    return "\n".join(rows) + "\n"


def levels() -> str:
    """What each level does."""
    rows = ["| word | level | limit | not hidden |", "|---|---|---|---|"]
    for (word, name), level in LEVEL_TABLE.items():
        shown = "; ".join(f"{c}: {_treatment(t)}" for c, t in level.treatments.items())
        rows.append(f"| {word} | {name} | {_limit(level)} | {shown} |")
    return "\n".join(rows) + "\n"


def types() -> str:
    """The contents of the fields of each type."""
    rows = ["```"]
    for name, fields in sorted(TYPES.items()):
        by_content: dict[Content, list[str]] = {}
        for field, content in fields.items():
            by_content.setdefault(content, []).append(field)
        said = "; ".join(f"{content} {' '.join(names)}" for content, names in by_content.items())
        rows.append(f"{name}: {said}".rstrip(": "))
    return "\n".join([*rows, "```"]) + "\n"


TABLES: Final = {"contents": contents, "levels": levels, "types": types}


def written(text: str) -> str:
    """`text` with its tables as they are now."""
    for name, table in TABLES.items():
        begin = _BEGIN.format(name)
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}{table()}{_END}{rest.partition(_END)[2]}"
    return text


if __name__ == "__main__":
    SPEC.write_text(written(SPEC.read_text()))
