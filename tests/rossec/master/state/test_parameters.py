"""The parameter tree: items affected, updates, limits. Answers: see test_differential."""

import contextlib
from copy import deepcopy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.master.state.parameters import (
    DEPTH_LIMIT,
    ParameterMissing,
    Parameters,
    check_names,
    encoded_size,
    search_candidates,
    subscription_key,
    updates,
)


def tree() -> Parameters:
    parameters = Parameters()
    parameters.set("/", {"a": {"b": 1, "c": {"d": 2}}, "e": {}})
    return parameters


def test_the_item_of_a_key() -> None:
    assert tree().item("/") == ("/", {"a": {"b": 1, "c": {"d": 2}}, "e": {}})
    assert tree().item("/a/c") == ("/a/c", {"d": 2})
    assert tree().item("/a/b") == ("/a/b", 1)
    assert tree().item("/none") == ("/none", None)


def test_items_affected_include_a_value_that_would_become_a_tree() -> None:
    assert tree().items_affected("/a/b/new/deep") == [("/a/b", 1), ("/a/b/new/deep", None)]
    assert tree().items_affected("/a") == [("/a", {"b": 1, "c": {"d": 2}})]
    assert tree().items_affected("/none/b") == [("/none/b", None)]


@pytest.mark.parametrize(
    "name", ["a b", "1st", "", "a/b", "~a", "caf\u00e9", "a\nb", "x" * 255, "-", "a" * 500]
)
def test_an_illegal_name_in_a_tree_is_named(name: str) -> None:
    for value in ({name: 1}, {"fine": 1, "deep": {"er": {name: {}}}}):
        with pytest.raises(ValueError, match="cannot be the name of a parameter") as refused:
            check_names("/ns", value)
        assert repr(name[:80]) in str(refused.value)
    for fine in ({"a": {"b_1": [{name: 1}]}}, [{name: 2}]):
        check_names("/", fine)  # a name inside a list is never a key


def test_a_name_too_long_together_with_its_key_is_refused() -> None:
    check_names("/" + "k" * 200, {"a" * 50: 1})
    with pytest.raises(ValueError, match="'aaa"):
        check_names("/" + "k" * 200, {"a" * 60: 1})


def test_get_set_delete() -> None:
    parameters = tree()
    parameters.set("/a/b/new", 5)
    assert parameters.get("/a/b") == {"new": 5}
    parameters.delete("/a")
    assert parameters.item("/a/b") == ("/a/b", None)
    with pytest.raises(ParameterMissing):
        parameters.get("/a")
    for key in ("/", "/none", "/none/x"):
        with pytest.raises(ParameterMissing):
            parameters.delete(key)
    assert parameters.get("/") == {"e": {}}


def test_values_that_cannot_be_read_again_are_refused() -> None:
    parameters = Parameters()
    with pytest.raises(TypeError, match="cannot set root"):
        parameters.set("/", 1)
    for value in ({"a/b": 1}, [None], 2**31):
        with pytest.raises(ValueError, match="cannot"):
            parameters.set("/x", value)
    with pytest.raises(ValueError, match="nested deeper"):
        parameters.set("/a" * (DEPTH_LIMIT + 1), 1)
    with pytest.raises(ValueError, match="nested deeper"):
        parameters.set("/a" * DEPTH_LIMIT, [[1]])
    assert parameters.get("/") == {}


def test_the_size_of_all_parameters_is_limited_and_can_shrink() -> None:
    parameters = tree()
    limit = parameters.size + 2000
    parameters.set("/big", "x" * 1000, limit)
    for key in ("/more", "/a/b", "/deep/er/than/that"):
        with pytest.raises(ValueError, match=f"more than {limit} bytes"):
            parameters.set(key, "x" * 2000, limit)
    assert parameters.item("/deep") == ("/deep", None)
    parameters.set("/big", "y" * 1900, limit)
    parameters.set("/more", "x" * 2000)  # from an earlier run, which had a higher limit
    parameters.set("/big", "y" * 1000, limit)  # fewer is fine, though still too many
    with pytest.raises(ValueError, match="more than"):
        parameters.set("/c", 1, limit)
    parameters.delete("/more")
    parameters.set("/c", 1, limit)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["/", "/a", "/a/b", "/a/b/c", "/d"]),
            st.sampled_from([1, "text", {}, {"b": 1}, {"b": {"c": "x", "d": []}}, None]),
        ),
        max_size=12,
    )
)
def test_the_size_is_that_of_all_parameters(changes: list[tuple[str, object]]) -> None:
    parameters = Parameters()
    for key, value in changes:
        with contextlib.suppress(ParameterMissing, TypeError):
            if value is None:
                parameters.delete(key)
            else:
                parameters.set(key, deepcopy(value))
    assert parameters.size == encoded_size({"": parameters.get("/")})


def test_a_search_climbs_and_looks_for_the_first_segment() -> None:
    assert search_candidates("/ns/node", "x/y") == [
        ("/ns/node/x", "/ns/node/x/y"),
        ("/ns/x", "/ns/x/y"),
        ("/x", "/x/y"),
    ]
    assert search_candidates("/ns/node", "/x/y") == [("/x/y", "/x/y")]
    for key in ("", "~x"):
        with pytest.raises(ValueError, match="invalid key"):
            search_candidates("/ns/node", key)


SUBSCRIPTIONS = [subscription_key(key) for key in ("/a", "/a/b", "/z", "/")]


def received_calls(key: str, value: object) -> list[tuple[str, str, object]]:
    return [(u.subscription, u.key, u.value) for u in updates(SUBSCRIPTIONS, key, value)]


def test_subscribers_above_at_and_below_are_notified() -> None:
    assert received_calls("/a/b", 1) == [("/", "/a/b/", 1), ("/a/", "/a/b/", 1), ("/a/b/", "/a/b/", 1)]
    assert received_calls("/a", {"b": 5}) == [
        ("/", "/a/", {"b": 5}),
        ("/a/", "/a/", {"b": 5}),
        ("/a/b/", "/a/b/", 5),
    ]
    assert received_calls("/a", {"c": 5})[2] == ("/a/b/", "/a/b/", {})


def test_an_update_is_a_copy() -> None:
    value = {"b": [1]}
    [update] = updates(["/a/"], "/a", value)
    value["b"].append(2)
    assert update.value == {"b": [1]}


keys = st.lists(st.sampled_from("abc"), min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
trees = st.recursive(st.integers(0, 3), lambda t: st.dictionaries(st.sampled_from("abc"), t, max_size=2))


@pytest.mark.ros
@given(key=keys, value=trees, subscriptions=st.lists(keys, unique=True), setter=st.sampled_from(["/a", "/b"]))
def test_updates_equal_rosmasters(key: str, value: object, subscriptions: list[str], setter: str) -> None:
    stock = pytest.importorskip("rosmaster.paramserver")
    registrations = pytest.importorskip("rosmaster.registrations").Registrations(4)
    for name in subscriptions:
        registrations.register(subscription_key(name), "/a", "http://a:1/")
    expected = [
        (name, changed, new)
        for nodes, changed, new in stock.compute_param_updates(registrations, key, value, setter)
        for name, _ in nodes
    ]
    got = [
        ("/a", update.key, update.value)
        for update in updates(list(registrations.iterkeys()), key, value)
        if update.to_setter or setter != "/a"
    ]
    order = repr
    assert sorted(got, key=order) == sorted(expected, key=order)
