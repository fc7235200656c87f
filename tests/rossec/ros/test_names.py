"""Name arithmetic, also side by side with rosgraph."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import NameRefused
from rossec.ros import names


@pytest.mark.parametrize(
    ("name", "node", "expected"),
    [
        ("/a/b", "/ns/n", "/a/b"),
        ("b", "/ns/n", "/ns/b"),
        ("b", "/n", "/b"),
        ("~b", "/ns/n", "/ns/n/b"),
        ("~/b", "/ns/n", "/ns/n/b"),
        ("", "/ns/n", "/ns/"),
        ("//a///b/", "/n", "/a/b"),
        ("/", "/n", "/"),
    ],
)
def test_resolve(name: str, node: str, expected: str) -> None:
    assert names.resolve(name, node) == expected


def test_remappings_apply_to_the_resolved_name() -> None:
    assert names.resolve("b", "/ns/n", {"/ns/b": "/c"}) == "/c"
    assert names.resolve("x", "/ns/n", {"/ns/b": "/c"}) == "/ns/x"


@pytest.mark.parametrize("name", ["a b", "/1a", "/a-b", "/a:b", "/", "~", "/" + "a" * 300])
def test_a_name_that_is_used_is_well_formed(name: str) -> None:
    settings = names.read([], {}, default_name="/n")
    if name == "~":  # a node's own name is well-formed
        assert settings.resolve(name) == "/n"
        return
    with pytest.raises(NameRefused):
        settings.resolve(name)


@pytest.mark.parametrize(
    ("prefix", "name", "expected"),
    [("/a", "b", "/a/b"), ("/", "b", "/b"), ("", "b", "b"), ("/a", "/b", "/b"), ("/a", "~b", "~b")],
)
def test_join(prefix: str, name: str, expected: str) -> None:
    assert names.join(prefix, name) == expected


@pytest.mark.ros
@given(st.text("ab/~", max_size=6), st.lists(st.text("ab", min_size=1, max_size=2), min_size=1, max_size=3))
def test_equal_to_rosgraph(name: str, parts: list[str]) -> None:
    rosgraph = pytest.importorskip("rosgraph.names")
    node = "/" + "/".join(parts)
    assert names.canonical(name) == rosgraph.canonicalize_name(name)
    assert names.namespace(node) == rosgraph.namespace(node)
    assert names.resolve(name, node) == rosgraph.resolve_name(name, node)
