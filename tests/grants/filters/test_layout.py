"""Layouts: ROS's checksums, sizes, and hostile definitions."""

import importlib
import time
from contextlib import suppress
from typing import Any

import pytest

from grants.errors import DefinitionRefused
from grants.filters.layout import MAX_TEXT, Array, Primitive, Struct, Text, dependencies, parse, service_md5
from tests.grants.messages import EVERYTHING, LAYOUT, SEPARATOR, layout, seeded_random

ROS_PACKAGES = (
    "actionlib_msgs",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rosgraph_msgs",
    "sensor_msgs",
    "shape_msgs",
    "std_msgs",
    "stereo_msgs",
    "tf2_msgs",
    "trajectory_msgs",
    "visualization_msgs",
)


def ros_types() -> list[Any]:
    import genpy

    found = []
    for package in ROS_PACKAGES:
        try:
            module = importlib.import_module(f"{package}.msg")
        except ImportError:
            continue
        values = vars(module).values()
        found += [v for v in values if isinstance(v, type) and issubclass(v, genpy.Message)]
    return found


@pytest.mark.ros
def test_the_checksum_of_every_installed_type() -> None:
    types = ros_types()
    assert len(types) >= 60
    for kind in types:
        assert parse(kind._type, kind._full_text).md5 == kind._md5sum, kind._type


def test_known_checksums() -> None:
    assert parse("std_msgs/String", "string data").md5 == "992ce8a1687cec8c8bd883ec73ca41d1"
    assert parse("std_msgs/Empty", "").md5 == "d41d8cd98f00b204e9800998ecf8427e"
    point = "float64 x\nfloat64 y\nfloat64 z"
    assert parse("geometry_msgs/Point", point).md5 == "4a842b65f413084dc2b10fb484ea7f17"
    vector = f"Point[] points\n{SEPARATOR}\nMSG: geometry_msgs/Point\n{point}\n"
    assert parse("geometry_msgs/Polygon", vector).md5 == parse("geometry_msgs/Line", vector).md5


def test_comments_and_spaces_do_not_change_the_checksum() -> None:
    spaced = "# c\n\n  int32   x # y\nint32 A=1 # one\r\n"
    assert layout(spaced).md5 == layout("int32 A = 1\nint32 x").md5
    assert layout("string S=a # b").md5 != layout("string S=a").md5


def test_the_layout_tree_of_a_definition() -> None:
    fields = dict(LAYOUT.root.fields)
    header, points, named = fields["header"], fields["points"], fields["named"]
    assert isinstance(header, Struct)
    assert header.name == "std_msgs/Header"
    assert isinstance(points, Array)
    assert isinstance(points.element, Struct)
    assert (points.name, points.size, points.element.size) == ("test_msgs/Point[]", None, 24)
    assert isinstance(named, Array)
    assert named.element.size is None
    assert (fields["corners"].name, fields["corners"].size) == ("test_msgs/Point[2]", 48)
    assert isinstance(fields["stamp"], Primitive)
    assert isinstance(fields["text"], Text)
    assert LAYOUT.root.size is None
    assert layout("N[0] none", "MSG: t/N\nstring s").root.size == 0
    assert LAYOUT.root.explain_missing("x").startswith("no field 'x' in test_msgs/Everything (has")
    assert layout("").root.explain_missing("x").endswith("(has no fields)")


def nested(depth: int, line: str = "t/B{} x\nt/B{} y") -> str:
    sections = [line.format(0, 0)]
    sections += [f"MSG: t/B{n}\n" + line.format(n + 1, n + 1) for n in range(depth)]
    return f"\n{SEPARATOR}\n".join([*sections, f"MSG: t/B{depth}\nint32 x"])


REFUSED = {
    "too long": ("#" * (MAX_TEXT + 1), "characters of definition"),
    "one word": ("int32", "not a field"),
    "three words": ("int32 a b", "not a field"),
    "bad name": ("int32 1a", "not a field"),
    "code as a name": ("int32 a);import", "not a field"),
    "unicode name": ("int32 ä", "not a field"),
    "bad type": ("int-32 a", "not a field type"),
    "two brackets": ("int32[][] a", "not a field type"),
    "negative": ("int32[-1] a", "not a field type"),
    "long length": ("int32[9999999999] a", "not a field type"),
    "huge array": ("float64[99999999] a", "larger than"),
    "twice": ("int32 a\nint8 a", "two fields 'a'"),
    "unknown type": ("Pose pose", "t/Pose is missing"),
    "unknown package": ("x/Pose pose", "x/Pose is missing"),
    "header array": ("Header[] h", "t/Header is missing"),
    "no header": ("Header h", "std_msgs/Header is missing"),
    "itself": ("T t", "nested in itself"),
    "a ring": (f"A a\n{SEPARATOR}\nMSG: t/A\nT t", "nested in itself"),
    "defined twice": (f"{SEPARATOR}\nMSG: t/A\n{SEPARATOR}\nMSG: t/A", "defined twice"),
    "root twice": (f"int8 a\n{SEPARATOR}\nMSG: t/T\nint32 a", "defined twice"),
    "no MSG": (f"{SEPARATOR}\nint32 a", "expected 'MSG: package/Type'"),
    "bad MSG": (f"{SEPARATOR}\nMSG: Pose", "expected 'MSG: package/Type'"),
    "ends early": (SEPARATOR, "expected 'MSG: package/Type'"),
    "constant without a name": ("int32 =1", "not a constant"),
    "constant of a message": ("Pose A=1", "not a constant"),
    "constant time": ("time A=1", "not a constant"),
    "only a sign": ("=", "not a constant"),
    "surrogates": ("string A=\ud800", "lone surrogates"),
    "too deep": (nested(40, "t/B{} x"), "deeper than 32"),
    "huge struct": (f"A[4000] a\n{SEPARATOR}\nMSG: t/A\nfloat64[1000] x", "larger than"),
    "many": ("\n".join(f"int8 a{n}" for n in range(5000)), "more than 4096 fields"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_invalid_definitions_are_refused(name: str) -> None:
    definition, message = REFUSED[name]
    with pytest.raises(DefinitionRefused, match=message):
        parse("t/T", definition)


@pytest.mark.parametrize("name", ["T", "t/", "/T", "a/b/c", "t/T\n", "1/T", ""])
def test_invalid_type_names_are_refused(name: str) -> None:
    with pytest.raises(DefinitionRefused, match="not a message type"):
        parse(name, "")


def test_an_exponential_definition_is_refused_without_expansion() -> None:
    before = time.process_time()
    with pytest.raises(DefinitionRefused, match="more than 4096 fields"):
        parse("t/T", nested(30))
    assert time.process_time() - before < 5  # expanded it would take days


def test_mutated_definitions_are_parsed_or_refused() -> None:
    rng = seeded_random(5)
    for _ in range(2000):
        mutated = list(EVERYTHING)
        for _ in range(rng.randrange(1, 4)):
            mutated[rng.randrange(len(mutated))] = rng.choice("\n =#/[]A1a\t\x00é")
        with suppress(DefinitionRefused):
            parse("test_msgs/Everything", "".join(mutated))


def test_the_checksum_of_a_service_is_over_both_parts() -> None:
    request = parse("std_srvs/SetBoolRequest", "bool data # comment")
    response = parse("std_srvs/SetBoolResponse", "bool success\nstring message\n")
    nothing = parse("std_srvs/TriggerRequest", "")
    assert service_md5(request, response) == "09fb03525b03e7ea1fd3992bafd87e16"
    assert service_md5(nothing, response) == "937c9679a518e3a18d831e57125ea522"


def test_the_digest_covers_brackets_the_checksum_omits() -> None:
    """genmsg omits array brackets after a message type."""
    plain = parse("t/A", f"B x\nt/B y\n{SEPARATOR}\nMSG: t/B\nint8 v\n")
    same = parse("t/A", f"t/B x # first\nB y\n{SEPARATOR}\nMSG: t/B\n# inner\nint8 v\n")
    assert plain.digest == same.digest
    others = [
        parse("t/A", f"{x} x\n{y} y\n{SEPARATOR}\nMSG: t/B\nint8 v\n")
        for x, y in (("B[]", "B"), ("B[0]", "B[2]"), ("B[1]", "B"), ("B", "B[]"))
    ]
    others.append(parse("t/A", f"C x\nC y\n{SEPARATOR}\nMSG: t/C\nint8 v\n"))
    assert {other.md5 for other in others} == {plain.md5}
    assert len({plain.digest, *(other.digest for other in others)}) == 1 + len(others)
    deep = [
        parse("t/A", f"B x\n{SEPARATOR}\nMSG: t/B\nC{array} v\n{SEPARATOR}\nMSG: t/C\nint8 v\n")
        for array in ("", "[3]")
    ]
    assert deep[0].md5 == deep[1].md5
    assert deep[0].digest != deep[1].digest


@pytest.mark.parametrize(
    ("text", "proven"),
    [("string[] a\nfloat64[3] b\ntime c\n", True), ("", True), ("B a", False), ("B[2] a", False)],
)
def test_a_checksum_proves_layouts_without_messages(text: str, proven: bool) -> None:
    assert parse("t/A", f"{text}\n{SEPARATOR}\nMSG: t/B\nint8 v\n").is_proven is proven


def test_dependencies_of_a_definition() -> None:
    text = "Header header\nB[] b\nu/C c\nHeader[2] more\nstring s\nint8 X=1"
    assert dependencies("t/A", text) == {"std_msgs/Header", "t/B", "u/C", "t/Header"}
    for bad in ("what is this", "B[-1] b"):
        with pytest.raises(DefinitionRefused):
            dependencies("t/A", bad)
