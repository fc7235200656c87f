"""Calls with another caller_id, compared with how stock resolves names."""

from typing import Any

import pytest

from rossec.master.state.parameters import Parameters, search_candidates
from rossec.participant.registrations import (
    not_found,
    resolve_params,
    search_places,
    search_result,
    searched_key,
)


@pytest.mark.parametrize(
    ("method", "params", "meant"),
    [
        ("getParam", ("/ns/tool", "x"), "/ns/x"),
        ("getParam", ("/rosparam-17", "~x"), "/rosparam-17/x"),
        ("setParam", ("/ns/tool", "/x", 1), "/x"),
        ("subscribeParam", ("/ns/tool", "http://h:1/", "x"), "/ns/x"),
        ("getPublishedTopics", ("/ns/tool", "sub"), "/ns/sub"),
        ("registerService", ("tool", "s"), "/s"),
        ("lookupNode", ("", "n"), "/n"),
    ],
)
def test_a_relative_name_is_resolved_for_the_original_caller(
    method: str, params: tuple[Any, ...], meant: str
) -> None:
    found = resolve_params(method, params, params[0])
    index = 2 if method == "subscribeParam" else 1
    assert found == (*params[:index], meant, *params[index + 1 :])


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("getParam", ("/ns/tool",)),
        ("getParam", ("/ns/tool", 7)),
        ("getParam", ("/ns/tool", "")),
        ("getPublishedTopics", ("/ns/tool", "")),  # all topics, not those of the namespace
        ("searchParam", ("/ns/tool", "x")),
        ("getSystemState", ("/ns/tool",)),
    ],
)
def test_other_calls_are_not_changed(method: str, params: tuple[Any, ...]) -> None:
    assert resolve_params(method, params, "/ns/tool") == params


@pytest.mark.parametrize(
    ("method", "params", "key"),
    [
        ("searchParam", ("/x", "a/b"), "a/b"),
        ("searchParam", ("/x", "/a"), None),
        ("searchParam", ("/x", "~a"), None),
        ("searchParam", ("/x", ""), None),
        ("searchParam", ("/x", 7), None),
        ("searchParam", ("/x",), None),
        ("getParam", ("/x", "a"), None),
    ],
)
def test_the_key_searched_from_the_namespace_of_the_caller(
    method: str, params: tuple[Any, ...], key: str | None
) -> None:
    assert searched_key(method, params) == key


CALLERS = ["/", "/tool", "/a/tool", "/a/b/tool", "/a//b/tool/"]
SET = ["/x", "/a/x", "/a/b/y", "/a/tool/x", "/x/z", "/a/b/tool/y/z"]


@pytest.mark.parametrize("caller", CALLERS)
@pytest.mark.parametrize("key", ["x", "y", "y/z", "x/z", "none"])
def test_the_names_searched_are_those_the_master_searches(caller: str, key: str) -> None:
    for name in SET:
        tree = Parameters()
        tree.set(name, 1)
        there = [found for place, found in search_places(caller, key) if tree.item(place)[1] is not None]
        looked_at = search_candidates(caller, key)
        assert there == [found for place, found in looked_at if tree.item(place)[1] is not None]


def test_the_names_searched_for_a_long_caller_are_bounded() -> None:
    assert len(list(search_places("/a" * 10_000, "x"))) < 200


def test_an_answer_ends_or_continues_the_search() -> None:
    assert search_result([1, "Found [/x]", "/x"], "/x/y") == [1, "Found [/x/y]", "/x/y"]
    assert search_result([-1, "Cannot find parameter [/x] in an upwards search", ""], "/x") is None
    finals: list[list[object]] = [[-1, "rossec: revoked", 0], [0, "Internal failure", 0], ["odd"]]
    for final in finals:
        assert search_result(final, "/x") == final
    assert not_found("x") == [-1, "Cannot find parameter [x] in an upwards search", ""]
