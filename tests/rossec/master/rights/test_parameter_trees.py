"""Rights on trees: the result equals that of checking every leaf, with fewer checks."""

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.decision import Reach
from grants.model import Permission, Right
from rossec.master.api import parameter_calls
from rossec.master.api.parameter_calls import (
    decisions,
    decisions_across_turns,
    has_right_on_all,
    parameter_names,
    require_tree,
)
from rossec.master.rights.caller import Caller, Refused
from tests.rossec.master.fakes import caller, everything, refuse

GET = Right.PARAM_GET
segments = st.sampled_from(["a", "b", "c"])
patterns = st.lists(segments | st.sampled_from(["*", "**"]), min_size=1, max_size=3).map(
    lambda parts: "/" + "/".join(parts)
)
values = st.recursive(st.integers(0, 1), lambda t: st.dictionaries(segments, t, max_size=3))


def holder(*held: str) -> Caller:
    return Caller("/n", b"n", Reach(Permission(pattern, GET) for pattern in held), refuse)


def leaves(key: str, value: object) -> Iterator[str]:
    if not isinstance(value, dict) or not value:
        yield key
        return
    for name, below in value.items():
        yield from leaves(f"{key.removesuffix('/')}/{name}", below)


@given(st.lists(patterns, max_size=3), st.sampled_from(["/", "/a", "/a/b"]), values)
def test_the_result_equals_that_of_checking_every_leaf(held: list[str], key: str, value: object) -> None:
    who = holder(*held)
    assert has_right_on_all(who, GET, [(key, value)]) == all(who.may(GET, at) for at in leaves(key, value))


@given(st.lists(patterns, max_size=3), values)
def test_covered_names_are_shown(held: list[str], value: object) -> None:
    who = holder(*held)
    decided = decisions_across_turns(who, GET, ("/", value))
    shown = [name for decision in decided if decision.covered for name in parameter_names(decision.item)]
    expected = [at for at in leaves("/", value) if who.may(GET, at)]
    assert [name for name in expected if name in set(parameter_names(("/", value)))] == shown


def test_no_items_are_not_covered() -> None:
    with pytest.raises(Refused, match="no grant covers it and all below it"):
        require_tree(everything("/a"), GET, "/k")
    require_tree(everything("/a"), GET, "/k", ("/k", 1), ("/k", {"x": 1}))
    with pytest.raises(Refused) as refused:
        require_tree(caller("/a", {"/k/x": GET}), GET, "/k", ("/k/x", 1), ("/k/y", 1))
    assert refused.value.missing == (GET, "/k")


class Counted(Reach):
    checks = 0

    def covers(self, right: Right, name: str) -> bool:
        Counted.checks += 1
        return super().covers(right, name)


def test_the_check_ends_at_the_first_uncovered_name() -> None:
    many = {f"p{number}": 1 for number in range(1000)}
    for held in ([], [Permission("/p1", GET)], [Permission("/far/away", GET)]):
        Counted.checks = 0
        who = Caller("/a", b"a", Counted(held), refuse)
        assert not has_right_on_all(who, GET, [("/", many)])
        assert Counted.checks < 10
    opened, *one = [decision.covered for decision in decisions(holder("/p7"), GET, ("/", many))]
    assert (opened, len(one), one.count(True), one.count(False)) == (None, 1000, 1, 999)
    assert [*decisions(holder("/**"), GET, ("/", many))] == [(("/", many), True)]
    assert [*decisions(holder("/else"), GET, ("/ns", many))] == [(("/ns", many), False)]


def test_a_tree_of_too_many_names_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameter_calls, "MAX_NAMES_CHECKED", 1 + 2 * 10)  # each with its namespace
    each, whole = holder("/*/x"), holder("/**")
    fits = {f"n{number}": {"x": 1} for number in range(10)}
    more = fits | {"n10": {"x": 1}}
    assert has_right_on_all(each, GET, [("/", fits)])
    assert not has_right_on_all(each, GET, [("/", more)])
    assert not has_right_on_all(each, GET, [("/", fits), ("/n0/x", 1)])
    assert has_right_on_all(whole, GET, [("/", more), ("/n0/x", 1)])


def test_namespaces_and_patterns_count_too() -> None:
    """The number of checks is limited, also for deep trees and many patterns."""
    deep: object = {"x": 1}
    for _ in range(30):
        deep = {"a": deep}
    fits = {f"n{number}": deep for number in range(200)}
    more = {f"n{number}": deep for number in range(2000)}
    assert has_right_on_all(holder("/**/x"), GET, [("/", fits)])
    assert not has_right_on_all(holder("/**/x"), GET, [("/", more)])
    many = holder("/*/x", *(f"/*/x{number}" for number in range(99)))
    assert many.patterns(GET) == 100
    assert has_right_on_all(many, GET, [("/", {f"n{number}": {"x": 1} for number in range(80)})])
    assert not has_right_on_all(many, GET, [("/", {f"n{number}": {"x": 1} for number in range(200)})])
    assert holder("/a/**", "/b").patterns(GET) == 0


def test_a_caller_with_many_patterns_checks_fewer_names_a_turn() -> None:
    assert holder("/a/**", "/b").names_per_yield == 64
    assert 1 < holder("/*/x", *(f"/*/x{number}" for number in range(99))).names_per_yield < 8
    assert holder(*(f"/*/x{number}" for number in range(4096))).names_per_yield == 1


def test_the_tree_may_change_while_it_is_shown() -> None:
    tree: dict[str, object] = {"a": {"x": 1}, "b": 2}
    decided = decisions_across_turns(holder("/*/x"), GET, ("/", tree))
    assert [next(decided).covered, next(decided).covered] == [None, None]
    del tree["b"]
    tree["c"] = 3
    assert [decision.covered for decision in decided] == [True, False]
    names = parameter_names(("/", tree))
    assert next(names) == "/a/x"
    tree["d"] = 4
    assert [*names] == ["/c"]
