"""Patterns over names: whole segments, absolute, ASCII."""

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ca.errors import NameRefused, PatternRefused
from ca.names import (
    MAX_NAME,
    check_name,
    check_pattern,
    check_tail_pattern,
    covers_below,
    covers_tree,
    pattern_covers,
    tail_base,
    touches,
)
from ca.names import covers as identity_covers

COVERED = [
    ("/a", "/a"),
    ("/a/b", "/a/b"),
    ("/*", "/a"),
    ("/a/*/c", "/a/b/c"),
    ("/**", "/a"),
    ("/**", "/a/b/c"),
    ("/a/**", "/a/b"),
    ("/a/**", "/a/b/c"),
    ("/a/**/z", "/a/b/z"),
    ("/a/**/z", "/a/b/c/z"),
    ("/a/**/z", "/a/z/z"),
    ("/**/z", "/a/z"),
    ("/**/*", "/a/b"),
    ("/**/**", "/a/b/c"),
]
NOT_COVERED = [
    ("/a", "/ab"),
    ("/a", "/a/b"),
    ("/ab", "/a"),
    ("/a/*", "/a"),
    ("/a/*", "/a/b/c"),
    ("/*", "/a/b"),
    ("/a/**", "/a"),
    ("/a/**", "/ab"),
    ("/a/**", "/ab/c"),
    ("/a/**/z", "/a/z"),
    ("/**/**", "/a"),
    ("/**/z", "/z"),
    ("/A", "/a"),
    ("/a/b/**", "/a"),
]
INVALID_NAMES = [
    "",
    "/",
    "a",
    "~a",
    "/~a",
    "//a",
    "/a/",
    "/a//b",
    "/a b",
    "/a\n",
    "/ä",
    "/a/../b",
    "/а",  # noqa: RUF001
    "/a-b",
    "/a.b",
    "/" + "a" * MAX_NAME,
]


@pytest.mark.parametrize(("pattern", "name"), COVERED)
def test_a_pattern_covers_the_name(pattern: str, name: str) -> None:
    assert pattern_covers(pattern, name)


@pytest.mark.parametrize(("pattern", "name"), NOT_COVERED)
def test_a_pattern_does_not_cover_the_name(pattern: str, name: str) -> None:
    assert not pattern_covers(pattern, name)


@pytest.mark.parametrize("text", INVALID_NAMES)
def test_invalid_names_are_refused(text: str) -> None:
    with pytest.raises(NameRefused):
        pattern_covers("/**", text)
    with pytest.raises(NameRefused):
        covers_tree("/**", text)
    with pytest.raises(PatternRefused) as refused:
        covers_tree(text, "/a")
    assert refused.value.hint


@pytest.mark.parametrize("text", ["/a*", "/*a", "/***", "/a/**b", "*", "**", "/a/*/"])
def test_invalid_patterns_are_refused(text: str) -> None:
    with pytest.raises(PatternRefused, match="not a name pattern"):
        check_pattern(text)


@pytest.mark.parametrize("text", ["/a/*", "/**"])
def test_a_pattern_is_not_a_name(text: str) -> None:
    assert check_pattern(text) == text
    with pytest.raises(NameRefused, match="not an absolute ROS name"):
        check_name(text)


@pytest.mark.parametrize(
    ("pattern", "name", "expected"),
    [
        ("/a", "/a", True),
        ("/a", "/a/b/c", True),
        ("/a", "/ab", False),
        ("/a/b", "/a", False),
        ("/a/*", "/a/b/c", True),
        ("/a/**", "/a", False),
        ("/a/**/d", "/a/b/d/e", True),
        ("/safety/max_speed", "/safety", False),
    ],
)
def test_a_pattern_covers_the_tree_below_a_name(pattern: str, name: str, expected: bool) -> None:
    assert covers_tree(pattern, name) is expected


SEGMENT = st.sampled_from(["a", "b", "ab"])
NAMES = st.lists(SEGMENT, min_size=1, max_size=5).map(lambda parts: "/" + "/".join(parts))
PATTERNS = st.lists(SEGMENT | st.sampled_from(["*", "**"]), min_size=1, max_size=5).map(
    lambda parts: "/" + "/".join(parts)
)


def _matches(pattern: list[str], name: list[str]) -> bool:
    """The definition as a recursive function."""
    if not pattern:
        return not name
    head, rest = pattern[0], pattern[1:]
    if head == "**":
        return any(_matches(rest, name[n:]) for n in range(1, len(name) + 1))
    return bool(name) and head in ("*", name[0]) and _matches(rest, name[1:])


@given(PATTERNS, NAMES)
def test_covers_follows_the_definition(pattern: str, name: str) -> None:
    split_pattern, split_name = pattern[1:].split("/"), name[1:].split("/")
    assert pattern_covers(pattern, name) is _matches(split_pattern, split_name)
    above = ["/" + "/".join(split_name[:n]) for n in range(1, len(split_name) + 1)]
    assert covers_tree(pattern, name) is any(pattern_covers(pattern, parent) for parent in above)


def test_many_wildcards_are_matched_fast() -> None:
    assert not pattern_covers("/**" * 80 + "/b", "/a" * 120)


@pytest.mark.parametrize(
    ("pattern", "namespace", "everywhere", "somewhere"),
    [
        ("/**", "/", True, True),
        ("/*", "/", True, True),
        ("/a", "/", False, True),
        ("/a", "/a", True, True),
        ("/a/*", "/a", True, True),
        ("/a/b", "/a", False, True),
        ("/a", "/ab", False, False),
        ("/*/b", "/a", False, True),
        ("/*/b", "/a/c", False, False),
        ("/**/z", "/a", False, True),
    ],
)
def test_a_pattern_covers_all_or_some_names_below_a_namespace(
    pattern: str, namespace: str, *, everywhere: bool, somewhere: bool
) -> None:
    assert covers_below(pattern, namespace) is everywhere
    assert touches(pattern, namespace) is somewhere


def test_an_invalid_pattern_covers_no_namespace() -> None:
    for compare in (covers_below, touches):
        with pytest.raises(PatternRefused):
            compare("/a*", "/a")


def test_a_pattern_has_no_label() -> None:
    with pytest.raises(PatternRefused) as caught:
        check_pattern("hospital:/robot/**")
    assert "have no label" in caught.value.hint


TAILS = [
    ("/rviz~", "/rviz", True),
    ("/rviz~", "/rviz_1", True),
    ("/rviz~", "/rviz_1_2", True),
    ("/rviz~", "/rviz_", False),
    ("/rviz~", "/rvizx", False),
    ("/rviz~", "/rviz_1/a", False),
    ("/rviz~/a", "/rviz_1/a", True),
    ("/rviz~/a", "/rviz/a", True),
    ("/rviz~/a", "/rviz_/a", False),
    ("/rviz~/a", "/rviz_1/b/a", False),
    ("/rviz~/a", "/x/rviz_1/a", False),
    ("/rviz~/**", "/rviz_1/a/b", True),
    ("/rviz~/**", "/rviz_1", False),
    ("/a/rviz~/*", "/a/rviz_1/b", True),
    ("/a/rviz~/*", "/a_1/rviz/b", False),
    ("/rviz_1~/a", "/rviz_1x/a", False),
    ("/rviz_1~/a", "/rviz_1_x/a", True),
]


@pytest.mark.parametrize(("pattern", "name", "expected"), TAILS)
def test_a_tail_pattern_covers_the_names_of_the_tail(pattern: str, name: str, expected: bool) -> None:
    assert check_tail_pattern(pattern) == pattern
    assert pattern_covers(pattern, name) is expected
    if expected:
        assert covers_tree(pattern, f"{name}/below")
        assert touches(pattern, name)


@pytest.mark.parametrize(
    "pattern",
    [
        "~",
        "/~",
        "~/a",
        "/rviz~x",
        "/rviz~~",
        "/rviz~/~",
        "/rviz~/a~",
        "/*~",
        "/**/rviz~",
        "/a/*~/b",
        "/rviz_~/",
        "/rviz~//a",
        "/rviz~/../a",
        "rviz~/a",
        "/master~/a",
        "/relay~",
        "/gateway/x~/a",
        "/rviz~/%61",
        "/rviz\u0303/a",
        "/rviz\uff5e/a",
        "/rviz~\n",
        "/1~",
        "/" + "r" * 200 + "~/" + "p" * 60,
    ],
)
def test_other_places_of_the_mark_are_refused(pattern: str) -> None:
    with pytest.raises(PatternRefused):
        check_tail_pattern(pattern)
    with pytest.raises(PatternRefused):
        pattern_covers(pattern, "/rviz_1/a")


@pytest.mark.parametrize("pattern", [each for each, _, _ in TAILS])
def test_a_tail_pattern_is_no_pattern_for_those_who_do_not_know_it(pattern: str) -> None:
    with pytest.raises(PatternRefused):
        check_pattern(pattern)
    assert tail_base(pattern) == pattern.split("~", maxsplit=1)[0]
    assert tail_base(pattern.replace("~", "")) is None


near = st.sampled_from(["r", "r_", "r_1", "r_1x", "rx", "r1", "_1", "a"])


@given(st.lists(near, min_size=1, max_size=2), st.lists(near, min_size=1, max_size=3))
def test_a_tail_pattern_agrees_with_the_identity(base: list[str], parts: list[str]) -> None:
    node, name = "/" + "/".join(base), "/" + "/".join(parts)
    assume(all(part[0].isalpha() for part in (*base, *parts)))
    assert pattern_covers(f"{node}~", name) is identity_covers(node, name, wildcard=True)
    assert pattern_covers(f"{node}~/a", f"{name}/a") is identity_covers(node, name, wildcard=True)


def test_no_tail_covers_a_whole_namespace() -> None:
    assert not covers_below("/rviz~/**", "/")
    assert not covers_below("/rviz~/**", "/rviz_")
    assert covers_below("/rviz~/**", "/rviz_1")
    assert touches("/rviz~/a", "/")
