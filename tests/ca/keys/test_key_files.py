import os
import stat
import subprocess
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from ca.errors import KeyRefused, PassphraseRefused
from ca.keys import private_keys
from ca.keys.signing import thumbprint


def public_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def write(path: Path, data: bytes, mode: int = 0o600) -> Path:
    path.write_bytes(data)
    path.chmod(mode)
    return path


def test_generate_makes_new_p256_keys() -> None:
    first, second = private_keys.generate(), private_keys.generate()
    assert isinstance(first.curve, ec.SECP256R1)
    assert thumbprint(first.public_key()) != thumbprint(second.public_key())


def test_unencrypted_round_trip(tmp_path: Path) -> None:
    key, path = private_keys.generate(), tmp_path / "node.key"
    private_keys.write_private(path, key)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert public_bytes(private_keys.load_private(path)) == public_bytes(key)


def test_round_trip_encrypted(tmp_path: Path) -> None:
    key, path = private_keys.generate(), tmp_path / "ca.key"
    private_keys.write_private(path, key, "pässword")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert public_bytes(private_keys.load_private(path, "pässword")) == public_bytes(key)
    other = load_pem_private_key(path.read_bytes(), "pässword".encode())
    assert isinstance(other, ec.EllipticCurvePrivateKey)
    assert public_bytes(other) == public_bytes(key)


def test_openssl_reads_the_encrypted_file(tmp_path: Path) -> None:
    key, path = private_keys.generate(), tmp_path / "ca.key"
    private_keys.write_private(path, key, "secret")
    done = subprocess.run(
        ["openssl", "pkey", "-in", path, "-passin", "pass:secret", "-pubout", "-outform", "DER"],
        capture_output=True,
        check=True,
    )
    assert done.stdout == public_bytes(key)


def test_existing_files_are_never_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "node.key", b"precious")
    with pytest.raises(KeyRefused, match="exists and is not overwritten") as caught:
        private_keys.write_private(path, private_keys.generate())
    assert "move the old key away" in caught.value.hint
    assert path.read_bytes() == b"precious"


def test_does_not_write_through_a_link(tmp_path: Path) -> None:
    path = tmp_path / "node.key"
    path.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(KeyRefused, match="exists and is not overwritten"):
        private_keys.write_private(path, private_keys.generate())
    assert not (tmp_path / "elsewhere").exists()


def test_an_empty_passphrase_is_none_chosen(tmp_path: Path) -> None:
    with pytest.raises(PassphraseRefused, match="the passphrase is empty"):
        private_keys.write_private(tmp_path / "ca.key", private_keys.generate(), "")
    assert not (tmp_path / "ca.key").exists()


def test_no_directory_to_write_to(tmp_path: Path) -> None:
    with pytest.raises(KeyRefused, match=r"cannot create .*No such file"):
        private_keys.write_private(tmp_path / "missing" / "node.key", private_keys.generate())


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(KeyRefused, match=r"cannot write .*No space left"):
        private_keys.write_private(tmp_path / "node.key", private_keys.generate())
    assert list(tmp_path.iterdir()) == []


def test_file_and_directory_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kinds: list[bool] = []
    monkeypatch.setattr(os, "fsync", lambda fd: kinds.append(stat.S_ISDIR(os.fstat(fd).st_mode)))
    private_keys.write_private(tmp_path / "node.key", private_keys.generate())
    assert kinds == [False, True]


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o601, 0o666])
def test_a_key_others_can_reach_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "node.key"
    private_keys.write_private(path, private_keys.generate())
    path.chmod(mode)
    with pytest.raises(KeyRefused, match="can be read or written by others") as caught:
        private_keys.load_private(path)
    assert f"chmod 600 {path}" in caught.value.hint


def test_a_missing_key_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KeyRefused, match="there is no key at"):
        private_keys.load_private(tmp_path / "node.key")


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    private_keys.write_private(tmp_path / "real.key", private_keys.generate())
    (tmp_path / "node.key").symlink_to(tmp_path / "real.key")
    with pytest.raises(KeyRefused, match="cannot open") as caught:
        private_keys.load_private(tmp_path / "node.key")
    assert "symbolic link" in caught.value.hint


def test_a_fifo_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "node.key", 0o600)
    with pytest.raises(KeyRefused, match="is not a regular file"):
        private_keys.load_private(tmp_path / "node.key")


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "node.key", bytes(8193))
    with pytest.raises(KeyRefused, match="is too large for a key"):
        private_keys.load_private(path)


@pytest.mark.parametrize("data", [b"", b"garbage", b"-----BEGIN PRIVATE KEY-----\n"])
def test_a_file_without_a_key_is_refused(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(KeyRefused, match="holds no private key"):
        private_keys.load_private(write(tmp_path / "node.key", data))


@pytest.mark.parametrize(
    "key", [ec.generate_private_key(ec.SECP384R1()), ed25519.Ed25519PrivateKey.generate()]
)
def test_a_key_file_holds_a_p256_key(
    tmp_path: Path, key: ec.EllipticCurvePrivateKey | ed25519.Ed25519PrivateKey
) -> None:
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with pytest.raises(KeyRefused, match="holds a key that is not P-256"):
        private_keys.load_private(write(tmp_path / "node.key", pem))


def test_passphrases_that_do_not_fit(tmp_path: Path) -> None:
    closed, plain = tmp_path / "ca.key", tmp_path / "node.key"
    private_keys.write_private(closed, private_keys.generate(), "right")
    private_keys.write_private(plain, private_keys.generate())
    with pytest.raises(PassphraseRefused, match="is encrypted"):
        private_keys.load_private(closed)
    with pytest.raises(PassphraseRefused, match="the passphrase does not open"):
        private_keys.load_private(closed, "wrong")
    with pytest.raises(PassphraseRefused, match="the passphrase does not open"):
        private_keys.load_private(closed, "")
    with pytest.raises(PassphraseRefused, match="not encrypted although a passphrase was given"):
        private_keys.load_private(plain, "right")
