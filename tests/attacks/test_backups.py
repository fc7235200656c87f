"""A crafted backup that is given to `ca restore`.

The attacker made it, knows its passphrase, and has the operator run the command.
"""

import base64
import ctypes
import os
import secrets
import sqlite3
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import cbor2
import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from ca.keys import passphrases
from rossec.authority.backup import back_up
from rossec.authority.home import AuthorityHome
from tests.ca.keys.test_pbes2 import asking
from tests.support.commands import PASSPHRASE, Said, Shell

pytestmark = [pytest.mark.attack("malicious-backup"), pytest.mark.timeout(600)]

Content = dict[str, bytes]
NOBODY = ("--master", "http://127.0.0.1:1")


@pytest.fixture
def empty(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """A home with nothing in it."""
    return Shell(tmp_path / "site" / "home", capsys)


@pytest.fixture(scope="module")
def genuine(tmp_path_factory: pytest.TempPathFactory) -> Content:
    """What is in a good backup."""
    home = AuthorityHome.create(
        tmp_path_factory.mktemp("genuine") / "home", "home", PASSPHRASE, int(time.time())
    )
    return passphrases.unseal(back_up(home, PASSPHRASE), PASSPHRASE)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Content:
    """The same of another authority, of the same name and passphrase."""
    home = AuthorityHome.create(
        tmp_path_factory.mktemp("foreign") / "home", "home", PASSPHRASE, int(time.time())
    )
    return passphrases.unseal(back_up(home, PASSPHRASE), PASSPHRASE)


def sealed(content: object) -> bytes:
    """A backup of any content, without the checks of `seal`."""
    salt, nonce = (secrets.token_bytes(passphrases.SALT_SIZE), secrets.token_bytes(passphrases.NONCE_SIZE))
    head = passphrases.MAGIC + salt + nonce
    plain = cbor2.dumps(content, canonical=True)
    return head + AESGCM(passphrases._key(PASSPHRASE, salt)).encrypt(nonce, plain, head)


def restore(shell: Shell, data: bytes) -> Said:
    file = shell.root / "given.backup"
    file.write_bytes(data)
    return shell.unlocked("ca", "restore", str(file), "--without-list")


def refused(shell: Shell, data: bytes, *said: str) -> None:
    """No file is added: in the home, beside it, or above."""
    before = sorted(shell.root.parent.rglob("*"))
    done = restore(shell, data)
    assert done.code == 1, done
    assert done.err.startswith("rossec: error: ")
    assert "Traceback" not in done.err
    for words in said:
        assert words in done.err, done.err
    left = {*shell.root.parent.rglob("*")} - {*before, shell.root / "given.backup"}
    assert left == set()


def test_the_genuine_one_is_restored(empty: Shell, genuine: Content) -> None:
    assert restore(empty, sealed(genuine)).code == 0


NAMES = [
    "../evil",
    "../../evil",
    "/tmp/rossec-evil",
    "node/../../evil",
    "node/../evil",
    "a/b",
    "..",
    ".",
    "",
    "node/",
    "node//x",
    "evil\x00.pem",
    "evil\n.pem",
    "evil\u202e.pem",
    "ev\u0456l",
    ".ssh",
    "ca.db-wal",
    "ca.db-shm",
    "ca.db-journal",
    "node/x-journal",
    "node",
    "inbox",
]


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_a_file_of_another_name(empty: Shell, genuine: Content, name: str) -> None:
    refused(empty, sealed({**genuine, name: b"evil"}), "is not a file of an authority")


@pytest.mark.parametrize("value", ["text", 5, [b"x"], {"a": b"x"}, None], ids=str)
def test_a_file_that_is_not_a_backup(empty: Shell, genuine: Content, value: object) -> None:
    refused(empty, sealed({**genuine, "policy.yaml": value}), "the backup is malformed")


@pytest.mark.parametrize(
    "content", [b"", [], "x", {1: b"x"}, {b"x": b"x"}], ids=["bytes", "list", "text", "one", "two"]
)
def test_a_backup_of_invalid_content(empty: Shell, content: object) -> None:
    refused(empty, sealed(content), "backup")


def test_a_huge_one(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    file = empty.root / "huge"
    with file.open("wb") as out:
        out.write(passphrases.MAGIC)
        out.truncate(passphrases.MAX_BACKUP + 1)
    said = empty.unlocked("ca", "restore", str(file))
    assert said.code == 1
    assert "is larger than" in said.err


@pytest.mark.parametrize("name", ["ca.key", "ca.pem", "ca.db"])
def test_a_part_is_missing(empty: Shell, genuine: Content, name: str) -> None:
    refused(empty, sealed({key: data for key, data in genuine.items() if key != name}))


@pytest.mark.parametrize("name", ["ca.key", "ca.pem", "ca.db"])
def test_a_part_is_garbage(empty: Shell, genuine: Content, name: str) -> None:
    refused(empty, sealed({**genuine, name: b"garbage" * 100}))


@pytest.mark.parametrize("name", ["ca.key", "ca.pem", "ca.db"])
def test_a_part_is_of_another_authority(empty: Shell, genuine: Content, foreign: Content, name: str) -> None:
    refused(empty, sealed({**genuine, name: foreign[name]}))


def test_two_certificates(empty: Shell, genuine: Content, foreign: Content) -> None:
    both = genuine["ca.pem"] + foreign["ca.pem"]
    refused(empty, sealed({**genuine, "ca.pem": both}), "authority: not exactly one certificate")


@pytest.mark.parametrize("costs", [(2**14, 8, 5000), (2**30, 8, 1)], ids=["time", "memory"])
def test_a_key_that_costs_minutes_to_try(empty: Shell, genuine: Content, costs: tuple[int, int, int]) -> None:
    text = base64.encodebytes(asking(*costs))
    kind = b"ENCRYPTED PRIVATE KEY-----\n"
    pem = b"-----BEGIN " + kind + text + b"-----END " + kind
    refused(empty, sealed({**genuine, "ca.key": pem}), "more work than a passphrase is worth")
    again = pem + genuine["ca.key"]
    refused(empty, sealed({**genuine, "ca.key": again}), "the passphrase does not open")


RECORDS = {
    "a trigger that forgets": "CREATE TRIGGER t BEFORE INSERT ON revocation BEGIN SELECT RAISE(IGNORE); END",
    "a trigger on the log": "CREATE TRIGGER t AFTER INSERT ON log BEGIN DELETE FROM csr; END",
    "a trigger in place of ours": "DROP TRIGGER revocation_no_DELETE; CREATE TRIGGER"
    " revocation_no_DELETE BEFORE DELETE ON revocation BEGIN SELECT 1; END",
    "a trigger less": "DROP TRIGGER revocation_no_DELETE",
    "a view": "CREATE VIEW v AS SELECT * FROM revocation",
    "a view for a table": "ALTER TABLE revocation RENAME TO kept;"
    "CREATE VIEW revocation AS SELECT * FROM kept WHERE 0",
    "a virtual table": "CREATE VIRTUAL TABLE t USING fts5(x)",
    "an index on an expression": "CREATE INDEX i ON revocation (abs(length(entry)))",
    "a table less": "DROP TABLE answer",
}


def crafted(genuine: Mapping[str, bytes], script: str, tmp_path: Path) -> Content:
    path = tmp_path / "crafted.db"
    path.write_bytes(genuine["ca.db"])
    db = sqlite3.connect(path, isolation_level=None)
    db.execute("PRAGMA journal_mode = DELETE")
    db.executescript(script)
    db.close()
    data = path.read_bytes()
    path.unlink()
    return {**genuine, "ca.db": data}


@pytest.mark.parametrize("script", RECORDS.values(), ids=RECORDS)
def test_a_record_with_a_trigger(empty: Shell, genuine: Content, script: str, tmp_path: Path) -> None:
    refused(empty, sealed(crafted(genuine, script, tmp_path)), "does not contain a valid authority")


def test_a_record_with_other_rows(empty: Shell, genuine: Content, tmp_path: Path) -> None:
    script = "INSERT INTO revocation VALUES (x'00', 'planted', 1)"
    refused(empty, sealed(crafted(genuine, script, tmp_path)), "not in the log")


Trap = Callable[[Path, Path], None]
TRAPS: dict[str, Trap] = {
    "to a directory": lambda place, elsewhere: place.symlink_to(elsewhere),
    "to nowhere": lambda place, elsewhere: place.symlink_to(elsewhere / "nothing"),
    "a file": lambda place, elsewhere: place.touch(),
}


@pytest.mark.parametrize("trap", TRAPS.values(), ids=TRAPS)
def test_a_link_at_the_destination(empty: Shell, genuine: Content, trap: Trap, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    trap(empty.root / "ca", elsewhere)
    refused(empty, sealed(genuine))
    assert list(elsewhere.iterdir()) == []


def test_a_home_that_others_can_write(empty: Shell, genuine: Content) -> None:
    empty.root.chmod(0o777)
    refused(empty, sealed(genuine), "can be written by others")


def test_restored_files_are_private(empty: Shell, genuine: Content) -> None:
    before = os.umask(0)
    try:
        assert restore(empty, sealed({**genuine, "-rf": b"x"})).code == 0
    finally:
        os.umask(before)
    for path in (empty.root / "ca").rglob("*"):
        assert path.stat().st_mode & 0o022 == 0, path
        assert not path.is_symlink()


URI = "pkcs11:token=home;object=authority?module-path={}"
OUTSIDE = "pkcs11-modules"


@pytest.fixture
def code(tmp_path: Path) -> tuple[Path, Path]:
    """A library, and the file that is there once it was loaded."""
    source, library, ran = (tmp_path / name for name in ("code.c", "code.so", "it-ran"))
    source.write_text(
        "#include <stdio.h>\n__attribute__((constructor)) static void run(void)\n"
        f'{{ FILE *file = fopen("{ran}", "w"); if (file) fclose(file); }}\n'
    )
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source], check=True)
    return library, ran


def behind(genuine: Content, module: Path | str) -> Content:
    """The backup of an authority whose key is in a token behind `module`."""
    content = {name: data for name, data in genuine.items() if name != "ca.key"}
    return {**content, "ca.uri": URI.format(module).encode()}


@pytest.mark.attack("backup-runs-code")
@pytest.mark.parametrize("extra", [{}, {"ca.key": b""}], ids=["alone", "beside a key file"])
def test_a_backup_names_code_to_be_run(
    empty: Shell, genuine: Content, code: tuple[Path, Path], extra: Content
) -> None:
    library, ran = code
    content = {**behind(genuine, library), **{name: genuine[name] for name in extra}}
    refused(empty, sealed(content), "as it says", "--pkcs11-module")
    assert not ran.exists()
    ctypes.CDLL(str(library))  # what it would have done
    assert ran.exists()


@pytest.mark.attack("backup-runs-code")
def test_the_operators_module_is_the_one_that_is_loaded(
    empty: Shell, genuine: Content, code: tuple[Path, Path], tmp_path: Path
) -> None:
    library, ran = code
    file, harmless = empty.root / "given.backup", tmp_path / "harmless.so"
    file.write_bytes(sealed(behind(genuine, library)))
    harmless.write_bytes(b"no library")
    restoring = ("ca", "restore", str(file), "--without-list")
    said = empty.unlocked(*restoring, "--pkcs11-module", str(harmless))
    assert said.code == 1
    assert not ran.exists()
    assert not (empty.root / "ca").exists()
    assert not (empty.root / OUTSIDE).exists(), "a restore that fails trusts nothing"


@pytest.mark.attack("backup-runs-code")
def test_a_backup_does_not_write_what_is_trusted(
    empty: Shell, genuine: Content, code: tuple[Path, Path]
) -> None:
    library, ran = code
    for name in (OUTSIDE, f"../{OUTSIDE}", f"node/{OUTSIDE}", f"inbox/{OUTSIDE}"):
        restore(empty, sealed({**genuine, name: str(library).encode()}))
        assert not (empty.root / OUTSIDE).exists()
        refused(empty, sealed({**behind(genuine, library), name: str(library).encode()}))
    assert not ran.exists()


@pytest.mark.attack("backup-runs-code")
def test_a_home_that_was_restored_needs_the_operators_word(
    empty: Shell, genuine: Content, code: tuple[Path, Path]
) -> None:
    """An older version restored it: nobody has named the module but the file."""
    library, ran = code
    assert restore(empty, sealed(genuine)).code == 0
    place = empty.root / "ca"
    (place / "ca.key").unlink()
    (place / "ca.uri").write_bytes(behind(genuine, library)["ca.uri"])
    for command in (("ca", "refresh", *NOBODY), ("ca", "backup", str(empty.root / "b"))):
        said = empty.unlocked(*command)
        assert said.code == 1
        assert "a module that is not trusted here" in said.err
        assert str(empty.root / OUTSIDE) in said.err
    assert not ran.exists()
