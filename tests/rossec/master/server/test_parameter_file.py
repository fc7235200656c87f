"""The journal file of parameters."""

import asyncio
import os
import stat
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from rossec.errors import NotWritten
from rossec.master.server import saved_state as module
from rossec.master.server.saved_state import ParameterFile
from rossec.master.state.journals import PARAMETERS_MAGIC, ParameterChange, decode_parameters
from tests.rossec.test_files import no_room


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "parameters.journal"


def opened(path: Path) -> ParameterFile:
    parameter_file = ParameterFile(path)
    parameter_file.open()
    return parameter_file


def size(path: Path) -> int:
    return path.stat().st_size


def records(path: Path) -> list[ParameterChange]:
    return decode_parameters(path.read_bytes())[0]


def change(parameter_file: ParameterFile, key: str, value: object) -> None:
    parameter_file.parameters.set(key, value)
    parameter_file.write(ParameterChange(key, value))


def test_a_change_survives_without_a_close(path: Path) -> None:
    parameter_file = opened(path)
    parameter_file.write(ParameterChange("/a", 1))
    again = opened(path)
    assert again.parameters.get("/") == {"a": 1}
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    parameter_file.close()
    again.close()
    parameter_file.write(ParameterChange("/b", 1))  # closed: nothing happens
    parameter_file.close()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_a_truncated_record_is_removed_and_saved_aside(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    parameter_file = opened(path)
    parameter_file.write(ParameterChange("/a", 1))
    parameter_file.close()
    whole = path.read_bytes()
    path.write_bytes(whole + whole[len(PARAMETERS_MAGIC) : -3])
    parameter_file = opened(path)
    parameter_file.write(ParameterChange("/b", 2))
    assert opened(path).parameters.get("/") == {"a": 1, "b": 2}
    assert "damaged" in caplog.text
    assert path.with_suffix(".damaged").read_bytes().startswith(whole)


def test_the_file_is_compacted_when_it_has_grown(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    parameter_file = opened(path)
    for number in range(100):
        parameter_file.parameters.set("/a", number)
        parameter_file.write(ParameterChange("/a", number))
    assert len(decode_parameters(path.read_bytes())[0]) == 100
    parameter_file.sync()
    assert decode_parameters(path.read_bytes())[0] == [ParameterChange("/a", 99)]
    parameter_file.write(ParameterChange("/b", 1))
    parameter_file.sync()
    parameter_file.sync()
    assert opened(path).parameters.get("/") == {"a": 99, "b": 1}


def test_a_full_disk_is_reported_and_leaves_no_half_record(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    parameter_file = opened(path)
    change(parameter_file, "/a", 1)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", lambda fd: os.fsync(1 << 20))
        parameter_file.sync()
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: write(fd, data[:5]))
        change(parameter_file, "/b", 2)
    assert caplog.text.count("parameters cannot be saved") == 2
    change(parameter_file, "/c", 3)
    assert opened(path).parameters.get("/") == {"a": 1, "c": 3}


def test_a_change_lost_to_a_full_disk_is_written_later(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parameter_file = opened(path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: os.fsync(1 << 20))
        change(parameter_file, "/a", 1)
    with monkeypatch.context() as patch:
        patch.setattr("rossec.files.replace", lambda *_: os.fsync(1 << 20))
        parameter_file.sync()  # still no space
    assert decode_parameters(path.read_bytes())[0] == []
    parameter_file.sync()
    assert opened(path).parameters.get("/") == {"a": 1}


def test_the_file_is_compacted_at_once_when_it_grows_too_fast(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    monkeypatch.setattr(module, "MAX_UNSYNCED", 10_000)
    parameter_file = opened(path)
    for number in range(200):
        change(parameter_file, "/a", number)
        assert path.stat().st_size < 11_000
    assert opened(path).parameters.get("/") == {"a": 199}


def test_a_full_disk_is_logged_and_the_file_is_unchanged(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept, reason = opened(path), "they are in force, and saved as soon as there is room"
    before = path.read_bytes()
    with no_room():
        change(kept, "/a", 1)
        kept.sync()
        assert path.read_bytes() == before
        with pytest.raises(NotWritten, match=r"parameters\.journal was not written"):
            ParameterFile(path).open()
    assert [reason in message for message in caplog.messages] == [True, True]
    kept.close()  # now there is space
    again = opened(path)
    assert again.parameters.get("/a") == 1
    again.close()


async def test_the_loop_goes_on_while_the_disk_syncs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parameter_file, syncs, go_on = opened(path), threading.Event(), threading.Event()

    def sync(_: int) -> None:
        syncs.set()
        assert go_on.wait(20)

    monkeypatch.setattr(os, "fdatasync", sync)
    change(parameter_file, "/a", 1)
    saving = asyncio.ensure_future(parameter_file.save())
    assert await asyncio.to_thread(syncs.wait, 20)
    change(parameter_file, "/b", 2)  # answered meanwhile
    assert not saving.done()
    go_on.set()
    await saving
    await parameter_file.save()
    await parameter_file.save()  # nothing to do
    parameter_file.close()
    assert opened(path).parameters.get("/") == {"a": 1, "b": 2}


def long_tree() -> dict[str, object]:
    return {f"n{each}": {f"k{number}": "x" * 1000 for number in range(100)} for each in range(20)}


async def changes_between(
    saving: "asyncio.Future[None]", file: ParameterFile, makes: Callable[[int], None]
) -> int:
    """Make a change in each pass of the loop until the file is saved; how many."""
    made = 0
    while not saving.done():
        makes(made)
        made += 1
        await asyncio.sleep(0)
    return made


async def test_changes_while_the_file_is_compacted_are_kept_in_their_order(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Set, replaced, deleted, and made a namespace: before and behind where the pieces are."""
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    parameter_file = opened(path)
    change(parameter_file, "/t", {"gone": 1})
    for _ in range(6):
        change(parameter_file, "/t", long_tree())
    before = size(path)

    def makes(number: int) -> None:
        name = f"/t/n{number * 7 % 20}"
        match number % 4:
            case 0:
                change(parameter_file, f"{name}/k{number % 100}", number)
            case 1 if f"n{number * 7 % 20}" in parameter_file.parameters.get("/t"):  # type: ignore[operator]
                parameter_file.parameters.delete(name)
                parameter_file.write(ParameterChange(name, deleted=True))
            case 2:
                change(parameter_file, f"/new{number}", [number])
            case _:
                change(parameter_file, name, number)

    saving = asyncio.ensure_future(parameter_file.save())
    assert await changes_between(saving, parameter_file, makes) > 5
    await saving
    assert size(path) < before / 2
    change(parameter_file, "/last", True)
    assert opened(path).parameters.get("/") == parameter_file.parameters.get("/")
    assert [each.name for each in path.parent.iterdir()] == [path.name]


async def test_a_compaction_that_fails_leaves_the_file_as_it_was(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    parameter_file = opened(path)
    for number in range(100):
        change(parameter_file, "/a", number)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", lambda fd: os.fsync(1 << 20))
        await parameter_file.save()
    assert "parameters cannot be saved" in caplog.text
    assert [each.name for each in path.parent.iterdir()] == [path.name]
    assert len(records(path)) == 100
    saving = asyncio.ensure_future(parameter_file.save())
    await asyncio.sleep(0)
    saving.cancel()
    with pytest.raises(asyncio.CancelledError):
        await saving
    assert parameter_file._dirty
    assert [each.name for each in path.parent.iterdir()] == [path.name]
    await parameter_file.save()
    assert opened(path).parameters.get("/") == {"a": 99}


async def test_much_that_is_written_is_saved_soon(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "GROWN", 2000)
    parameter_file = opened(path)
    while not parameter_file.grown.is_set():
        change(parameter_file, "/a", 1)
    await parameter_file.save()
    assert not parameter_file.grown.is_set()
    assert records(path) == [ParameterChange("/a", 1)]
