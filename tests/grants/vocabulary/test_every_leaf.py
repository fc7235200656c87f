"""Every leaf of every type changed at every level below `exact`: what may not show does not.

Through the product's own guard. `may_show` says what may, and why.
"""

from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import cache

import pytest

from grants.errors import FilterRefused
from grants.guard import Guard
from grants.vocabulary.contents import FRAMES, LEVELS, MEANINGS, TIMES, TYPES, Content, DataWord, describe
from grants.vocabulary.levels import resolve
from rossec.participant.host_types import layout_of
from rossec.participant.message_types import type_names
from tests.grants.vocabulary.leaves import base, mutations
from tests.grants.vocabulary.made import NOW, guard_of
from tests.grants.vocabulary.may_show import MAY_SHOW, Row

ALL_LEVELS = [(word, level) for word in DataWord for level in LEVELS[word][1:]]
_TIMES = (".stamp", ".seq", "Time.data", ".time_ref", ".map_load_time")


def through(guard: Guard, message: bytes) -> bytes:
    pieces = guard(message, NOW)
    assert pieces is not None
    return b"".join(pieces)


@cache
def shown(name: str, word: DataWord, level: str) -> frozenset[str]:
    """The keys of what shows of a type at a level; where the level is refused nothing does."""
    layout = layout_of(name)
    try:
        found = resolve(layout, describe(layout), {word: level})
    except FilterRefused:
        return frozenset()
    guard = guard_of(layout, found)
    first, keys = through(guard, base(layout)), set()
    for mutation in mutations(layout):
        if mutation.key not in keys and through(guard, mutation.message) != first:
            keys.add(mutation.key)
            assert through(guard, base(layout)) == first  # hysteresis has come back
    return frozenset(keys)


def rows_for(key: str, word: DataWord, level: str) -> Iterator[Row]:
    for row in MAY_SHOW:
        if word in row.words.split() and (not row.levels or level in row.levels.split()):
            for pattern in row.fields.split():
                whole = key if ">" in pattern else key.rpartition(" > ")[2]
                if fnmatchcase(whole, pattern):
                    yield row


@pytest.mark.parametrize(("word", "level"), ALL_LEVELS)
def test_what_shows_may_show(word: DataWord, level: str) -> None:
    leaks = {
        f"{name}: {key}"
        for name in TYPES
        for key in shown(name, word, level)
        if not any(rows_for(key, word, level))
    }
    assert sorted(leaks) == []


def test_every_row_is_of_something_that_shows() -> None:
    used = {
        row
        for name in TYPES
        for word, level in ALL_LEVELS
        for key in shown(name, word, level)
        for row in rows_for(key, word, level)
    }
    assert [row for row in MAY_SHOW if row not in used] == []


def test_no_moment_shows_in_a_message_that_tells_the_word() -> None:
    """A row says so of times for all types; `identity` keeps them where there are no names."""
    for name in TYPES:
        described = describe(layout_of(name))
        for word, level in ALL_LEVELS:
            telling = [
                field
                for field in described.fields
                if word in field.meaning.tells and field.content not in TIMES | FRAMES
            ]
            if not telling or (word is DataWord.IDENTITY and not described.has_names):
                continue
            times = {key for key in shown(name, word, level) if key.endswith(_TIMES)}
            assert times == set(), (name, word, level)


def test_there_is_much_to_change() -> None:
    changed = {(name, each.key) for name in TYPES for each in mutations(layout_of(name))}
    assert len(changed) > 900
    for name in TYPES:
        keys = {each.key.rpartition(" > ")[2] for each in mutations(layout_of(name))}
        of_values = {key.partition("[")[0].rpartition(".")[2] for key in keys}
        leaves = {f.path.rpartition(".")[2] for f in describe(layout_of(name)).fields}
        assert of_values >= leaves - {"height", "width", "encoding", "step"}, name


@pytest.mark.parametrize("name", sorted(set(type_names()) - TYPES.keys()))
def test_a_type_with_a_field_that_no_table_names_has_no_level(name: str) -> None:
    layout = layout_of(name)
    if all(field.content is not Content.UNKNOWN for field in describe(layout).fields):
        return  # it consists of types of the table
    for word, level in ALL_LEVELS:
        with pytest.raises(FilterRefused, match="tells is not known"):
            resolve(layout, describe(layout), {word: level})


def test_what_tells_a_position_tells_the_movement_and_the_other_way_round() -> None:
    """One is the integral of the other."""
    for content, meaning in MEANINGS.items():
        both = {DataWord.POSITION, DataWord.MOVEMENT} & meaning.tells
        assert len(both) != 1, content
