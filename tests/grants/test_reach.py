"""What is prepared answers as what is not."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.model import ALL_RIGHTS, Permission, Right
from grants.names import check_pattern
from grants.reach import Reach
from tests.grants.test_names import COVERED, NOT_COVERED

segments = st.sampled_from(["a", "ab", "b"])
names = st.lists(segments, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))
patterns = st.lists(segments | st.sampled_from(["*", "**"]), min_size=1, max_size=4).map(
    lambda parts: check_pattern("/" + "/".join(parts))
)
permissions = st.builds(Permission, patterns, st.integers(1, int(ALL_RIGHTS)).map(Right), st.none())


@given(st.lists(permissions, max_size=4), st.sampled_from(list(Right)), names)
def test_it_agrees_with_the_permissions(held: list[Permission], right: Right, name: str) -> None:
    expected = any(permission.covers(right, name) for permission in held)
    assert Reach(held).covers(right, name) == expected


@given(st.lists(permissions, max_size=4), st.integers(0, int(ALL_RIGHTS)).map(Right), names)
def test_any_of_some_rights(held: list[Permission], rights: Right, name: str) -> None:
    reach = Reach(held)
    expected = any(reach.covers(right, name) for right in Right if right in rights)
    assert reach.covers_any(rights, name) == expected
    assert reach.covers_any(rights, name) == expected  # what was worked out is remembered


@pytest.mark.parametrize(("pattern", "name"), COVERED)
def test_covered(pattern: str, name: str) -> None:
    assert Reach([Permission(pattern, Right.PUBLISH)]).covers(Right.PUBLISH, name)


@pytest.mark.parametrize(("pattern", "name"), NOT_COVERED)
def test_not_covered(pattern: str, name: str) -> None:
    assert not Reach([Permission(pattern, Right.PUBLISH)]).covers(Right.PUBLISH, name)


@pytest.mark.parametrize(
    "name", ["", "a", "/", "/a/", "//a", "/a//b", "/a/1", "/caf\u00e9", "/a" * 200]
)
def test_what_is_no_name_is_not_covered(name: str) -> None:
    assert not Reach([Permission("/**", ALL_RIGHTS)]).covers(Right.PUBLISH, name)


def test_only_one_right_is_a_question() -> None:
    reach = Reach([Permission("/a", ALL_RIGHTS)])
    for right in (Right(0), Right.PUBLISH | Right.SUBSCRIBE, Right(256)):
        assert not reach.covers(right, "/a")
    assert not Reach([]).covers(Right.PUBLISH, "/a")
