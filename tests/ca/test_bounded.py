"""Tables with a limit: what is used stays, the oldest goes, nothing outlives its time."""

from ca.bounded import ExpiringTable, Newest


def test_the_oldest_makes_room_and_what_was_set_or_used_is_not_the_oldest() -> None:
    table: Newest[str, int] = Newest(2)
    table["a"], table["b"] = 1, 2
    table["a"] = 3
    table["c"] = 4
    assert dict(table) == {"a": 3, "c": 4}
    assert table.use("a") == 3
    table["d"] = 5
    assert dict(table) == {"a": 3, "d": 5}
    assert table.use("c") is None


def test_a_value_ends_at_its_time_and_is_replaced_whole() -> None:
    table: ExpiringTable[str, int] = ExpiringTable(2, 10.0)
    table.put("a", 1, 100.0)
    assert (table.get("a", 109.9), table.get("a", 110.0)) == (1, None)
    table.put("a", 2, 105.0)
    assert (table.get("a", 110.0), table.get("b", 0.0)) == (2, None)
    table.put("b", 3, 105.0)
    table.put("c", 4, 105.0)
    assert table.get("a", 105.0) is None
