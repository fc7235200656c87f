"""Tables with shares: who fills one ends what is their own, and nothing of a higher rank."""

from rossec.peer_limits import SharedTable


def filled(limit: int, *owners: tuple[str, int]) -> SharedTable[int, str]:
    table: SharedTable[int, str] = SharedTable(limit)
    for number, (owner, rank) in enumerate(owners):
        table.add(number, f"{owner}{number}", owner, rank)
    return table


def test_whoever_has_most_makes_room_with_the_oldest() -> None:
    table = filled(4, ("b", 0), ("a", 0), ("a", 0), ("a", 0))
    assert table.add(9, "new", "c") == ["a1"]
    assert [value for _, value in table.items()] == ["b0", "a2", "a3", "new"]


def test_a_flood_ends_only_what_is_its_own() -> None:
    table = filled(4, ("owner", 0))
    for number in range(10, 100):
        assert table.add(number, "flood", "stranger") is not None
    assert table.get(0) == "owner0"
    assert len(table) == 4


def test_a_lower_rank_ends_nothing_of_a_higher_one() -> None:
    table = filled(3, ("a", 1), ("a", 1), ("a", 1))
    assert table.add(9, "new", "b", 0) is None
    assert table.add(9, "new", "b", 1) == ["a0"]


def test_a_higher_rank_ends_the_lower_first() -> None:
    table = filled(3, ("phone", 1), ("phone", 1), ("look", 0))
    assert table.add(9, "new", "phone", 1) == ["look2"]


def test_where_all_have_one_a_newcomer_has_none() -> None:
    table = filled(2, ("a", 0), ("b", 0))
    assert table.add(9, "new", "c") is None
    assert table.add(9, "new", "a") == ["a0"]


def test_what_is_put_in_anew_is_the_newest() -> None:
    table = filled(2, ("a", 0), ("a", 0))
    assert table.add(0, "again", "a") == []
    assert table.items() == [(1, "a1"), (0, "again")]
    assert table.owner(0) == ("a", 0)
    assert table.pop(0) == "again"
    assert (table.get(0), table.pop(0), table.owner(0)) == (None, None, None)
