from pathlib import Path

import pytest

from rossec import files
from rossec.cli import namespace as names
from rossec.cli.namespace import MAX_FILES, read
from rossec.errors import ConfigurationError, MetadataRefused, NotWritten
from tests.rossec.namespace.launch_texts import launch, node, simple, topic


def include(file: str) -> str:
    return f'  <include file="{file}"/>\n'


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "home.launch"
    path.write_bytes(launch(node("<ns:group>g</ns:group>")))
    return path


def test_a_file_is_written_for_everybody_and_none_is_overwritten(source: Path) -> None:
    out = source.with_name("out.launch")
    found = read(source, out, simple)
    found.write()
    assert out.read_bytes() == launch(node(more=' ns="/g"'))
    assert out.stat().st_mode & 0o777 == 0o644 & ~_umask()
    out.write_text("mine")
    with pytest.raises(ConfigurationError, match="exists and is not overwritten"):
        found.write()
    assert out.read_text() == "mine"


def _umask() -> int:
    import os

    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_files_of_the_same_directory_are_followed(source: Path) -> None:
    source.write_bytes(launch(include("$(dirname)/a.launch"), include("$(dirname)/a.launch")))
    inside = launch(node("<ns:group>a</ns:group>"), include("$(dirname)/home.launch"))
    source.with_name("a.launch").write_bytes(inside)
    out = source.parent / "made" / "out.launch"
    out.parent.mkdir()
    found = read(source, out, simple)
    found.write()
    assert out.read_bytes() == launch(2 * include("$(dirname)/out.a.launch"))
    assert out.with_name("out.a.launch").read_bytes() == launch(
        node(more=' ns="/a"'), include("$(dirname)/out.launch")
    )
    assert [each.name for each in found.nodes] == ["/a/lamp"]
    assert found.notes == []


def test_nothing_is_written_where_one_of_the_files_is_there_already(source: Path) -> None:
    source.write_bytes(launch(include("$(dirname)/a.launch")))
    source.with_name("a.launch").write_bytes(launch(node("<ns:group>a</ns:group>")))
    source.with_name("out.a.launch").write_text("mine")
    out = source.with_name("out.launch")
    with pytest.raises(ConfigurationError, match=r"out\.a\.launch exists"):
        read(source, out, simple).write()
    assert not out.exists()


@pytest.mark.parametrize(
    "file",
    [
        "$(find robot)/a.launch",
        "/etc/a.launch",
        "a.launch",
        "$(dirname)/../a.launch",
        "$(dirname)/missing.launch",
        "$(dirname)/$(arg a).launch",
    ],
)
def test_what_is_not_followed_is_said(source: Path, file: str) -> None:
    source.write_bytes(launch(node("<ns:group>g</ns:group>"), include(file)))
    found = read(source, source.with_name("out.launch"), simple)
    (note,) = found.notes
    assert f"home.launch: line 5: {file} is not followed" in note
    assert include(file).encode() in found.written[source.with_name("out.launch")]


def test_other_files_beside_it_are_missed_in_another_directory(source: Path) -> None:
    source.write_bytes(launch('<rosparam file="$(dirname)/a.yaml"/>'))
    (note,) = read(source, source.parent / "x" / "out.launch", simple).notes
    assert "by $(dirname)" in note
    assert read(source, source.with_name("out.launch"), simple).notes == []


def test_errors_name_file_and_line(source: Path) -> None:
    source.write_bytes(launch(node("<ns:name>a</ns:name>")))
    with pytest.raises(MetadataRefused, match=r"home\.launch: line 3: "):
        read(source, source.with_name("out.launch"), simple)
    with pytest.raises(ConfigurationError, match=r"none\.launch"):
        read(source.with_name("none.launch"), source.with_name("out.launch"), simple)


def test_one_name_in_two_files(source: Path) -> None:
    lamp = node("<ns:group>g</ns:group>")
    source.write_bytes(launch(lamp, include("$(dirname)/a.launch")))
    source.with_name("a.launch").write_bytes(launch(lamp))
    with pytest.raises(MetadataRefused, match="2 nodes /g/lamp"):
        read(source, source.with_name("out.launch"), simple)


def test_one_topic_of_two_nodes_is_worth_a_word(source: Path) -> None:
    def shared(metadata: bytes, queries: list[object]) -> list[str]:
        return [f"/n{len(metadata)}", "/light"]

    source.write_bytes(launch(node(topic()), node(topic(), name="lamp22")))
    (note,) = read(source, source.with_name("out.launch"), shared).notes  # type: ignore[arg-type]
    assert "2 nodes get the name /light" in note


def test_where_one_cannot_be_written_none_is_left(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the same command can be given again once there is space."""
    source.write_bytes(launch(include("$(dirname)/a.launch")))
    source.with_name("a.launch").write_bytes(launch())
    out = source.with_name("out.launch")
    found, create = read(source, out, simple), files.create
    first, second = found.written

    def full(path: Path, data: bytes, mode: int) -> None:
        if path == second:
            raise NotWritten("no space is left")
        create(path, data, mode)

    monkeypatch.setattr(files, "create", full)
    with pytest.raises(NotWritten):
        found.write()
    assert not first.exists()
    monkeypatch.undo()
    found.write()
    assert first.exists()
    assert second.exists()


def test_no_file_takes_the_place_of_another(source: Path) -> None:
    source.write_bytes(launch(include("$(dirname)/launch")))
    source.with_name("launch").write_bytes(launch())
    with pytest.raises(ConfigurationError, match=r"two files would become .*out\.launch$"):
        read(source, source.with_name("out.launch"), simple)


def test_not_too_many_files(source: Path) -> None:
    for number in range(MAX_FILES + 1):
        text = launch(include(f"$(dirname)/{number + 1}.launch"))
        source.with_name(f"{number}.launch").write_bytes(text)
    with pytest.raises(MetadataRefused, match="more than"):
        read(source.with_name("0.launch"), source.with_name("out.launch"), simple)


def test_the_limit_is_that_of_metadata(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(names, "MAX_INPUT", 10)
    with pytest.raises(ConfigurationError, match="10"):
        read(source, source.with_name("out.launch"), simple)
