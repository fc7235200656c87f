"""The message types a host knows: of its packages, and of ROS."""

from pathlib import Path

import pytest

from grants.filters.layout import MAX_TEXT
from rossec.participant import host_types
from rossec.participant.host_types import known_type
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


def test_packages_are_found_along_ros_package_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a directory of packages, or given itself; nested types may be standard types."""
    package(tmp_path / "ws" / "my_robot", Drive="my_parts/Axle[2] axles\nHeader header\n")
    own = package(
        tmp_path / "else" / "my_parts", Axle="Wheel left  # \xe9\nWheel right", Wheel="float32 r"
    )
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
        Drive="my_parts/Axle axle", Odd="what is this", Loop="Loop inner",
        Long="#" * (MAX_TEXT + 1),
    )  # fmt: skip
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
