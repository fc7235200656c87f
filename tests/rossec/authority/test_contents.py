from pathlib import Path

import pytest

from ca.errors import CAError, PathRefused
from rossec.authority import backup
from rossec.authority.keyservice import messages

KEPT = [
    "ca.key",
    "ca.uri",
    "ca.pem",
    "ca.db",
    "intermediate.pem",
    "intermediate.csr",
    "policy.yaml",
    "inbox/ab12.request",
    "outgoing/ab12.grant",
    "delegations/ab12.cose",
    "node/node.key",
    "node/node.csr",
    "node/node.pem",
    "node/ca.pem",
    "node/revocations.cose",
    "node/domains.cose",
    "node/foreign/hospital.example.cose",
    "node/filters/ward.key",
]
NOT_KEPT = [
    "ca.db-wal",
    "ca.db-shm",
    "audit.log",
    "audit.log.1.gz",
    "service.lock",
    "console/lock",
    "console/address",
    "console/tls.key",
    "console/tls.pem",
    "node/grants/ab12.grant",
]


def filled(directory: Path, *names: str) -> Path:
    for name in names:
        path = directory / name
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.write_bytes(name.encode())
        path.chmod(0o600)
    return directory


@pytest.mark.parametrize("name", KEPT)
def test_each_of_these_is_in_a_backup_once(name: str, tmp_path: Path) -> None:
    assert [each.kept for each in backup.OWNED if each.names(name)] == [True]
    content = {} if name == "ca.db" else {name: name.encode()}  # the record is a snapshot
    assert backup.kept(filled(tmp_path, name)) == content
    assert backup.restorable({name: b"x"}) == ({name: b"x"}, [])
    public = name.endswith(".pem")
    assert backup.mode(name) == (0o644 if public else 0o600)


@pytest.mark.parametrize("name", NOT_KEPT)
def test_these_are_declared_and_stay_out(name: str, tmp_path: Path) -> None:
    assert [each.kept for each in backup.OWNED if each.names(name)] == [False]
    filled(tmp_path, name)
    assert (backup.kept(tmp_path), backup.undeclared(tmp_path)) == ({}, [])
    assert backup.restorable({name: b"x"}) == ({}, [name])


def test_what_nobody_declares_is_named_and_not_taken_along(tmp_path: Path) -> None:
    filled(tmp_path, "notes.txt", "node/node.key.bak", ".ca.key.0123", "policy.yaml")
    assert backup.undeclared(tmp_path) == ["node/node.key.bak", "notes.txt"]
    assert list(backup.kept(tmp_path)) == ["policy.yaml"]


def test_a_backup_of_an_older_version_may_have_more_in_its_places() -> None:
    content = {"ca.pem": b"", "policy.yaml.bak": b"", "inbox/x": b""}
    assert backup.restorable(content) == ({"ca.pem": b""}, ["inbox/x", "policy.yaml.bak"])


@pytest.mark.parametrize("name", ["a/b", "console/x", "node/foreign/x", "outgoing/x.key"])
def test_other_places_are_refused(name: str) -> None:
    with pytest.raises(CAError, match="is not a file of an authority"):
        backup.restorable({name: b""})


def test_a_link_is_followed_for_the_policy_alone(tmp_path: Path) -> None:
    filled(tmp_path, "elsewhere/mine.yaml")
    home = filled(tmp_path / "ca", "ca.pem")
    (home / "policy.yaml").symlink_to(tmp_path / "elsewhere" / "mine.yaml")
    assert backup.kept(home)["policy.yaml"] == b"elsewhere/mine.yaml"
    (home / "ca.key").symlink_to(tmp_path / "elsewhere" / "mine.yaml")
    with pytest.raises(PathRefused, match="is a symbolic link"):
        backup.kept(home)


def test_what_an_older_one_would_undo_stays(tmp_path: Path) -> None:
    filled(tmp_path, *KEPT)
    assert set(backup.staying(tmp_path)) == {
        "policy.yaml",
        "node/revocations.cose",
        "node/domains.cose",
        "node/foreign/hospital.example.cose",
    }


def test_sockets_are_no_files(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / messages.SOCKET))
        assert backup.undeclared(tmp_path) == []
