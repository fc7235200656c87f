"""What can be checked of docs/spec/model without ProVerif: names, numbers of arguments, labels."""

import re
from pathlib import Path
from typing import Final

import pytest

MODEL: Final = Path(__file__).parents[1] / "docs" / "spec" / "model"
README: Final = (MODEL / "README.md").read_text()
FILES: Final = {path.name: path.read_text() for path in MODEL.glob("*.pv*")}
MAIN: Final = {"handshake.pv": "edhoc.pvl", "secrecy.pv": "edhoc.pvl", "records.pv": ""}
BUILT_IN: Final = {"out": 2, "in": 2, "event": 1, "inj-event": 1, "attacker": 1}
LANGUAGE: Final = {
    "set",
    "free",
    "const",
    "type",
    "fun",
    "reduc",
    "equation",
    "forall",
    "event",
    "table",
    "query",
    "let",
    "in",
    "out",
    "new",
    "if",
    "then",
    "else",
    "process",
    "insert",
    "get",
    "phase",
    "private",
    "data",
    "bitstring",
    "channel",
    "attacker",
    "inj-event",
    "false",
    "ignoreTypes",
}
LABEL: Final = re.compile(r"\(\* \[([\w-]+)\]")
WORD: Final = r"[A-Za-z_][A-Za-z0-9_'-]*"


def bare(text: str) -> str:
    """The text without its comments, which may be nested."""
    kept, depth = [], 0
    for part in re.split(r"(\(\*|\*\))", text):
        depth += {"(*": 1, "*)": -1}.get(part, 0)
        assert depth >= 0
        if depth == 0 and part != "*)":
            kept.append(part)
    assert depth == 0
    return "".join(kept)


def arguments(text: str, start: int) -> list[str]:
    """What stands between the parenthesis at `start` and its own end, by its outer commas."""
    depth, parts, begun = 0, [], start + 1
    for place in range(start, len(text)):
        depth += {"(": 1, ")": -1}.get(text[place], 0)
        if depth == 0 or (depth == 1 and text[place] == ","):
            parts.append(text[begun:place].strip())
            begun = place + 1
        if depth == 0:
            return [] if parts == [""] else parts
    raise AssertionError(f"a parenthesis that does not end: {text[start : start + 60]}")


def declared(text: str) -> dict[str, int]:
    """Functions, destructors, events, tables and processes, with how many arguments they take."""
    found = {}
    for kind in ("fun", "event", "table", "let"):
        for match in re.finditer(rf"^{kind} ({WORD})(\()?", text, re.MULTILINE):
            found[match[1]] = len(arguments(text, match.end() - 1)) if match[2] else 0
    for match in re.finditer(rf"^reduc forall [^;]*;\s*({WORD})\(", text, re.MULTILINE):
        found[match[1]] = len(arguments(text, match.end() - 1))
    return found


def whole(main: str) -> str:
    """A file with its library, without comments."""
    return bare(FILES[MAIN[main]] + FILES[main] if MAIN[main] else FILES[main])


def test_the_files_are_these() -> None:
    assert set(FILES) == {*MAIN, "edhoc.pvl"}
    for name in MAIN:
        library = f"-lib {MAIN[name]} " if MAIN[name] else ""
        assert f"    proverif {library}{name}\n" in README


@pytest.mark.parametrize("main", MAIN)
def test_names_are_declared_and_take_that_many_arguments(main: str) -> None:
    text = whole(main)
    arities = declared(text)
    assert arities
    used = set()
    for match in re.finditer(rf"({WORD})\(", text):
        name, given = match[1], arguments(text, match.end() - 1)
        if name in BUILT_IN:
            assert len(given) == BUILT_IN[name], match[0]
        else:
            assert name in arities, f"{name} is not declared"
            assert len(given) == arities[name], f"{name} takes {arities[name]}: {given}"
            used.add(name)
    for name in re.findall(rf"\bevent ({WORD})", text):
        assert name in arities
    assert "" not in used


@pytest.mark.parametrize("main", MAIN)
def test_every_name_means_something(main: str) -> None:
    """Whatever is a word in a process or query is declared, bound there, or the language's own."""
    text = whole(main)
    known = LANGUAGE | set(declared(text))
    for names in re.findall(rf"^(?:free|const|type) ({WORD}(?:, {WORD})*)", text, re.MULTILINE):
        known.update(names.split(", "))
    known.update(re.findall(rf"^type ({WORD})", text, re.MULTILINE))
    known.update(re.findall(rf"\btype ({WORD})\.", text))
    known.update(re.findall(rf"({WORD})\s*:\s*{WORD}", text))  # typed where it is bound
    for pattern in re.findall(rf"\blet ({WORD}|{WORD}\([^)]*\))\s*=", text):
        known.update(re.findall(WORD, pattern))
    unknown = {word for word in re.findall(rf"(?<![\w']){WORD}", text) if word not in known}
    assert not unknown


def test_the_initiators_events_say_whom_it_wanted() -> None:
    text = bare(FILES["edhoc.pvl"])
    begin, end = text.index("let i_finishes("), text.index("let r_finishes(")
    events = re.findall(rf"event ({WORD})\(([^)]*)\)", text[begin:end])
    assert len(events) == 6
    for name, given in events:
        assert given.split(", ")[:2] == ["own", "wanted"], name


def test_the_table_names_every_query_and_lines_that_are_there() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \| ([\w.]+) \|.*\| true \| (.+) \|$", README, re.MULTILINE)
    asked = {
        (query, name) for name, text in FILES.items() for query in re.findall(r"\(\* \{([\w-]+)\}", text)
    }
    assert {(query, name) for query, name, _ in rows} == asked
    assert len(rows) == len(asked) == 11
    named = set()
    for query, name, lines in rows:
        there = set(LABEL.findall(FILES[name] + FILES.get(MAIN[name], "")))
        mentioned = set(re.findall(r"`([\w-]+)`", lines))
        assert {label for label in mentioned if "-" in label} <= there, query
        assert mentioned & there, query
        named |= mentioned & there
    marked = LABEL.findall("".join(FILES.values()))
    assert sorted(marked) == sorted(named), "a label that no query depends on, or one twice"
