"""Comparison of patterns, checked with the names they cover."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.names import covers_tree, pattern_covers
from grants.model import Right
from grants.policy.names import gives, includes, intersects, intersects_tree, overlaps

plain = st.lists(st.sampled_from(["a", "b", "*", "**"]), min_size=1, max_size=3).map(
    lambda parts: "/" + "/".join(parts)
)
tails = st.sampled_from(["/a~", "/a~/b", "/a~/**", "/a_b~", "/b/a~", "/a~/*"])
patterns = plain | tails
# Names that show any difference: segments that only wildcards match, and that only tails do.
NAMES = [
    "/" + "/".join(parts) for n in range(1, 5) for parts in product(("a", "b", "z", "a_z", "a_b_z"), repeat=n)
] + ["/" + "/".join(parts) for n in (5, 6) for parts in product("abz", repeat=n)]


@pytest.mark.parametrize(
    ("outer", "inner", "expected"),
    [
        ("/a/**", "/a/b", True),
        ("/a/**", "/a", False),
        ("/a", "/ab", False),
        ("/**", "/a/*/b", True),
        ("/*", "/**", False),
        ("/a/*", "/*/a", False),
        ("/**/a", "/a", False),
        ("/**", "/**", True),
        ("/**/*", "/*/**", True),
    ],
)
def test_includes(outer: str, inner: str, expected: bool) -> None:
    assert includes(outer, inner) is expected


@given(patterns, patterns)
def test_a_pattern_includes_another_if_it_covers_its_names(outer: str, inner: str) -> None:
    expected = all(pattern_covers(outer, name) for name in NAMES if pattern_covers(inner, name))
    assert includes(outer, inner) is expected


@given(patterns, patterns)
def test_patterns_intersect_if_they_share_a_name(one: str, other: str) -> None:
    expected = any(pattern_covers(one, name) and pattern_covers(other, name) for name in NAMES)
    assert intersects(one, other) is expected


@given(patterns, patterns)
def test_trees_intersect_if_they_share_a_key(one: str, other: str) -> None:
    expected = any(covers_tree(one, name) and covers_tree(other, name) for name in NAMES)
    assert intersects_tree(one, other) is expected


@given(patterns, patterns)
def test_a_tree_right_includes_what_lies_below(pattern: str, asked: str) -> None:
    expected = all(covers_tree(pattern, name) for name in NAMES if pattern_covers(asked, name))
    assert gives(pattern, Right.PARAM_GET, asked) is expected


def test_a_message_right_covers_exactly_the_names() -> None:
    assert not gives("/a", Right.SUBSCRIBE, "/a/b")
    assert gives("/a", Right.PARAM_SET, "/a/b")
    assert not overlaps("/a/b", Right.SUBSCRIBE, "/a")
    assert overlaps("/a/b", Right.PARAM_SET, "/a")
    assert overlaps("/a/*", Right.SUBSCRIBE, "/*/b")
