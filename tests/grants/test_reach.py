"""The index gives the same answers as the permissions."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.names import check_pattern
from grants.decision import Reach
from grants.model import ALL_RIGHTS, Permission, Restriction, Right
from tests.ca.test_patterns import COVERED, NOT_COVERED

segments = st.sampled_from(["a", "ab", "a_b", "b"])
names = st.lists(segments, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))
plain = st.lists(segments | st.sampled_from(["*", "**"]), min_size=1, max_size=4).map(
    lambda parts: check_pattern("/" + "/".join(parts))
)
tails = st.sampled_from(["/a~", "/a~/b", "/a~/**", "/a/a~/*", "/a_b~/a"])
patterns = plain | tails
permissions = st.builds(Permission, patterns, st.integers(1, int(ALL_RIGHTS)).map(Right), st.none())


@given(st.lists(permissions, max_size=4), st.sampled_from(list(Right)), names)
def test_the_index_agrees_with_the_permissions(held: list[Permission], right: Right, name: str) -> None:
    expected = any(permission.covers(right, name) for permission in held)
    assert Reach(held).covers(right, name) == expected


@given(st.lists(permissions, max_size=4), st.integers(0, int(ALL_RIGHTS)).map(Right), names)
def test_any_of_several_rights_is_covered(held: list[Permission], rights: Right, name: str) -> None:
    reach = Reach(held)
    expected = any(reach.covers(right, name) for right in Right if right in rights)
    assert reach.covers_any(rights, name) == expected
    assert reach.covers_any(rights, name) == expected  # the second result is cached


tree_rights = st.sampled_from([Right.PARAM_GET, Right.PARAM_SET])
spaces = st.just("/") | names
PARTS = ("a", "ab", "a_b", "b", "zz")  # the last is in no pattern


def below(space: str, depth: int) -> list[str]:
    """Names at most `depth` segments below `space`."""
    found = [] if space == "/" else [space]
    for _ in range(depth):
        found += [f"{name.removesuffix('/')}/{part}" for name in [space, *found] for part in PARTS]
    return [name for name in dict.fromkeys(found) if name != space]


@given(st.lists(permissions, max_size=3), tree_rights, spaces)
def test_rights_on_all_names_below_a_namespace(held: list[Permission], right: Right, space: str) -> None:
    """Names one segment below are sufficient: a right to a key includes its descendants."""
    reach = Reach(held)
    # Siblings must be covered by one pattern; several patterns together are not sufficient.
    single = any(all(permission.covers(right, name) for name in below(space, 1)) for permission in held)
    assert reach.covers_below(right, space) == single
    if reach.covers_below(right, space):
        assert all(reach.covers(right, name) for name in below(space, 2))


@given(st.lists(permissions, max_size=3), tree_rights, spaces)
def test_rights_on_some_name_below_a_namespace(held: list[Permission], right: Right, space: str) -> None:
    somewhere = any(Reach(held).covers(right, name) for name in [space, *below(space, 4)])
    assert Reach(held).touches(right, space) == somewhere


@pytest.mark.parametrize("space", ["/", "/a"])
def test_other_rights_do_not_apply_to_trees(space: str) -> None:
    reach = Reach([Permission("/**", ALL_RIGHTS)])
    assert reach.covers_below(Right.PARAM_GET, space)
    assert not reach.covers_below(Right.PUBLISH, space)
    assert not reach.touches(Right.SUBSCRIBE, space)
    assert not Reach([]).touches(Right.PARAM_GET, space)


@pytest.mark.parametrize(("pattern", "name"), COVERED)
def test_covered_names(pattern: str, name: str) -> None:
    assert Reach([Permission(pattern, Right.PUBLISH)]).covers(Right.PUBLISH, name)


@pytest.mark.parametrize(("pattern", "name"), NOT_COVERED)
def test_names_that_are_not_covered(pattern: str, name: str) -> None:
    assert not Reach([Permission(pattern, Right.PUBLISH)]).covers(Right.PUBLISH, name)


@pytest.mark.parametrize("name", ["", "a", "/", "/a/", "//a", "/a//b", "/a/1", "/caf\u00e9", "/a" * 200])
def test_invalid_names_are_not_covered(name: str) -> None:
    assert not Reach([Permission("/**", ALL_RIGHTS)]).covers(Right.PUBLISH, name)


def test_exactly_one_right_can_be_checked() -> None:
    reach = Reach([Permission("/a", ALL_RIGHTS)])
    for right in (Right(0), Right.PUBLISH | Right.SUBSCRIBE, Right(256)):
        assert not reach.covers(right, "/a")
    assert not Reach([]).covers(Right.PUBLISH, "/a")


def in_slots(name: str, slot: int, rights: Right = Right.SUBSCRIBE) -> Permission:
    return Permission(name, rights, Restriction(slot=slot))


SEEN = Right.SUBSCRIBE | Right.PUBLISH | Right.GRAPH


@pytest.mark.parametrize(
    ("held", "slot"),
    [
        ([in_slots("/a", 60)], 60),
        ([in_slots("/a", 60), in_slots("/a", 30), in_slots("/b", 10)], 30),
        ([in_slots("/a", 60), Permission("/a", Right.SUBSCRIBE)], 0),
        ([in_slots("/a", 60), Permission("/**", Right.GRAPH)], 0),
        ([in_slots("/a", 60), Permission("/b", Right.PUBLISH)], 60),
        ([in_slots("/a", 60), Permission("/a", Right.PARAM_GET)], 60),
        ([in_slots("/a", 60, Right.SUBSCRIBE | Right.PUBLISH)], 0),
        ([in_slots("/b", 60)], 0),
        ([], 0),
    ],
)
def test_the_slot_of_a_name_is_the_shortest_by_which_it_is_seen(held: list[Permission], slot: int) -> None:
    assert Reach(held).slot(SEEN, "/a") == slot


def test_of_a_chain_the_longest_slot_counts() -> None:
    links = [Reach([Permission("/**", SEEN)]), Reach([in_slots("/a", 60)])]
    chained = Reach([], [links])
    assert chained.has_slots
    assert chained.slot(SEEN, "/a") == 60
    assert chained.slot(SEEN, "/b") == 0
    assert Reach([], [[*links, Reach([in_slots("/a", 90)])]]).slot(SEEN, "/a") == 90
    assert Reach([in_slots("/a", 30)], [links]).slot(SEEN, "/a") == 30
    assert Reach([Permission("/a", Right.SUBSCRIBE)], [links]).slot(SEEN, "/a") == 0
    assert Reach([in_slots("/c", 30)], [[Reach([Permission("/a", SEEN)])]]).slot(SEEN, "/a") == 0
