"""The message types a host knows: of its packages, and of ROS."""

from pathlib import Path

import pytest

from grants.filters.layout import MAX_TEXT
from rossec.errors import MessageError
from rossec.participant import host_types
from rossec.participant.host_types import definition_of, known_type, layout_of, places
from rossec.participant.message_types import message_type, type_names


def package(place: Path, **messages: str) -> Path:
    (place / "msg").mkdir(parents=True)
    for name, text in messages.items():
        (place / "msg" / f"{name}.msg").write_text(text)
    return place


def test_standard_types_are_known() -> None:
    for name in type_names():
        known, own = known_type(name), message_type(name)
        assert known is not None
        assert (known.md5sum, known.layout.digest) == (own.md5sum, own.layout.digest)


@pytest.mark.parametrize("name", ["*", "", "none/Such", "../etc/passwd", "std_msgs/../String", "a"])
def test_other_types_are_unknown(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    assert known_type(name) is None


def test_packages_are_found_along_ros_package_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a directory of packages, or given itself; nested types may be standard types."""
    package(tmp_path / "ws" / "my_robot", Drive="my_parts/Axle[2] axles\nHeader header\n")
    own = package(tmp_path / "else" / "my_parts", Axle="Wheel left  # \xe9\nWheel right", Wheel="float32 r")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f":{tmp_path / 'ws'}:{own}")
    found = known_type("my_robot/Drive")
    assert found is not None
    assert [name for name, _ in found.layout.root.fields] == ["axles", "header"]
    assert found.layout.root.fields[0][1].size == 16


def test_types_with_missing_or_invalid_parts_are_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    package(
        tmp_path / "my_robot",
        Drive="my_parts/Axle axle",
        Odd="what is this",
        Loop="Loop inner",
        Long="#" * (MAX_TEXT + 1),
    )
    for name in ("Drive", "Odd", "Loop", "Long"):
        assert known_type(f"my_robot/{name}") is None


def test_a_type_with_too_many_dependencies_is_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    monkeypatch.setattr(host_types, "MAX_TYPES", 2)
    package(tmp_path / "my_robot", A="B b", B="C c", C="int8 c")
    assert known_type("my_robot/B") is not None
    assert known_type("my_robot/A") is None


def test_a_workspace_of_several_repositories(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As rospack finds them: not below a package, not behind a link, not too far down."""
    own = package(tmp_path / "src" / "repository" / "deep" / "far_msgs", Far="int8 a")
    (own / "package.xml").write_text("<package/>")
    package(own / "test" / "inner_msgs", Inner="int8 a")
    package(tmp_path / "src" / "a" / "b" / "c" / "d" / "e" / "deep_msgs", Buried="int8 a")
    package(tmp_path / "else" / "linked_msgs", Linked="int8 a")
    (tmp_path / "src" / "link").symlink_to(tmp_path / "else")
    (tmp_path / "src" / "loop").symlink_to(tmp_path / "src")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "src"))
    assert known_type("far_msgs/Far") is not None
    for name in ("inner_msgs/Inner", "deep_msgs/Buried", "linked_msgs/Linked"):
        assert known_type(name) is None


def test_a_workspace_is_not_searched_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(9):
        (tmp_path / f"a{number}" / "b").mkdir(parents=True)
    package(tmp_path / "z" / "far_msgs", Far="int8 a")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    assert known_type("far_msgs/Far") is not None
    monkeypatch.setattr(host_types, "_MOST_FOLDERS", 2)
    monkeypatch.setattr(host_types, "_DEPTH", 0)
    host_types._below.cache_clear()
    assert known_type("far_msgs/Far") is None
    host_types._below.cache_clear()


def test_what_is_installed_is_found_without_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package(tmp_path / "door_msgs", Door="bool open")
    monkeypatch.setattr(host_types, "INSTALLED", (str(tmp_path),))
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    assert known_type("door_msgs/Door") is not None
    assert places({"ROS_PACKAGE_PATH": "/a::/b:/a"}) == ["/a", "/b", str(tmp_path)]


def test_a_type_of_a_package_is_one_for_messages_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where types come from is one thing: `topic echo`, a built-in node, `explain` ask here too."""
    package(tmp_path / "shed_msgs", Shed="Header header\nDoor[] doors\n", Door="bool open")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    kind = message_type("shed_msgs/Shed")
    assert kind.md5sum == layout_of("shed_msgs/Shed").md5
    assert kind.serialize(kind.create()) == bytes(20)
    assert definition_of("shed_msgs/Shed").startswith("Header header")
    with pytest.raises(MessageError, match="unknown message type 'none/Such'"):
        definition_of("none/Such")
    with pytest.raises(MessageError, match="unknown message type 'none/Such'"):
        message_type("none/Such")
