"""The table covers every standard type, and says of which fields only the topic knows the meaning.

By the definitions that come with the product, and by those that Debian installs.
"""

import importlib

import pytest

from grants.filters.layout import Layout, parse
from grants.vocabulary.contents import TYPES, Content, describe
from tests.grants.vocabulary.layouts import PACKAGES, STANDARD, layout_of

KNOWN_HERE = sorted(TYPES)


def gaps(layout: Layout) -> list[str]:
    return [f.path for f in describe(layout).fields if f.content is Content.UNKNOWN]


def test_there_are_types_to_cover() -> None:
    assert len(STANDARD) >= 100
    assert {name.split("/")[0] for name in STANDARD} == set(PACKAGES)


@pytest.mark.parametrize("name", STANDARD)
def test_a_standard_type_is_covered(name: str) -> None:
    assert name in TYPES
    assert gaps(layout_of(name)) == []


@pytest.mark.parametrize("name", sorted(set(KNOWN_HERE) - set(STANDARD)))
def test_a_further_type_of_the_table_is_covered(name: str) -> None:
    assert gaps(layout_of(name)) == []


@pytest.mark.parametrize("name", KNOWN_HERE)
def test_the_table_names_fields_that_are_there(name: str) -> None:
    paths = {field.path for field in describe(layout_of(name)).fields}
    for named in TYPES[name]:
        assert any(f"{path}.".replace("[*]", "").startswith(f"{named}.") for path in paths), named


def test_bare_values_are_those_without_a_meaning_of_their_own() -> None:
    bare = {name for name in STANDARD if describe(layout_of(name)).unknown}
    arrays = {name for name in STANDARD if name.endswith("MultiArray")}
    vectors = {"geometry_msgs/Vector3", "geometry_msgs/Vector3Stamped"}
    numbers = {f"std_msgs/{kind}{bits}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
    others = {"Bool", "Byte", "Char", "Duration", "Float32", "Float64", "String"}
    assert bare == arrays | vectors | numbers | {f"std_msgs/{name}" for name in others}


@pytest.mark.ros
@pytest.mark.parametrize("package", PACKAGES)
def test_the_types_of_debian_are_covered(package: str) -> None:
    module = importlib.import_module(f"{package}.msg")
    kinds = [kind for kind in vars(module).values() if hasattr(kind, "_full_text")]
    own = [kind for kind in kinds if kind._type.startswith(f"{package}/")]
    assert own
    for kind in own:
        assert kind._type in TYPES
        assert gaps(parse(kind._type, kind._full_text)) == [], kind._type


@pytest.mark.ros
def test_transforms_are_covered() -> None:
    kind = importlib.import_module("tf2_msgs.msg").TFMessage
    assert gaps(parse(kind._type, kind._full_text)) == []
