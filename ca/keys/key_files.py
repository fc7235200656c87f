"""Private keys on disk: created with mode 0600 and O_EXCL, never overwritten, never printed.

This module does I/O and uses system randomness. A key that other users of the host can read is
refused, as by ssh: it must be assumed to be copied. The format is PKCS#8 in PEM, encrypted with
scrypt (`ca.keys.pbes2`) when there is a passphrase.
"""

import base64
import os
import secrets
import stat
from pathlib import Path
from typing import Final

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_der_private_key,
    load_pem_private_key,
)

from ca.errors import KeyRefused, PassphraseRefused
from ca.keys import ownership, pbes2
from ca.keys.publickey import thumbprint

__all__ = ["generate", "load_private", "thumbprint", "write_private"]

_MAX_FILE: Final = 8 * 1024
_ENCRYPTED: Final = b"-----BEGIN ENCRYPTED PRIVATE KEY-----"
_END: Final = _ENCRYPTED.replace(b"BEGIN", b"END")
# O_NONBLOCK: opening a FIFO must not hang; it is refused afterwards, as not a regular file.
_READ: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def generate() -> ec.EllipticCurvePrivateKey:
    """Return a new P-256 key."""
    return ec.generate_private_key(ec.SECP256R1())


def write_private(
    path: Path, key: ec.EllipticCurvePrivateKey, passphrase: str | None = None
) -> None:
    """Write `key` to the new file `path`, readable by its owner only, durable on return.

    Raises:
        PassphraseRefused: the passphrase is empty.
        KeyRefused: the file exists, or cannot be written; no partial file is left.
    """
    pem = _to_pem(key, passphrase)
    try:
        descriptor = os.open(path, _CREATE, 0o600)
    except FileExistsError:
        raise KeyRefused(
            f"{path} exists and is not overwritten", "move the old key away if it is not needed"
        ) from None
    except OSError as error:
        raise KeyRefused(f"cannot create {path}: {error.strerror}") from error
    try:
        _write_durably(descriptor, pem, path.parent)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise KeyRefused(
            f"cannot write {path}: {error.strerror}",
            "no key was created: make room, then try again",
        ) from error


def load_private(path: Path, passphrase: str | None = None) -> ec.EllipticCurvePrivateKey:
    """Return the P-256 key in the file `path`.

    Raises:
        PassphraseRefused: the passphrase is missing, wrong, or given for a key without one.
        PathRefused: another user owns or can replace it.
        KeyRefused: not a readable regular file, accessible by others, not a P-256 key, or
            trying the passphrase would cost too much.
    """
    pem = _read(path)
    _check_passphrase(path, passphrase, encrypted=_ENCRYPTED in pem)
    try:
        key = load_pem_private_key(pem, None) if passphrase is None else _open(pem, passphrase)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        if passphrase is not None:
            raise PassphraseRefused(
                f"the passphrase does not open {path}",
                "try again; if it is certainly right, the file is damaged: restore the backup",
            ) from error
        raise KeyRefused(
            f"{path} holds no private key", "restore the file from a backup"
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise KeyRefused(f"{path} holds a key that is not P-256", "create a new key with rossec")
    return key


def _open(pem: bytes, passphrase: str) -> PrivateKeyTypes:
    """The encrypted key in a file, after its cost was checked: of the same bytes."""
    before, _, text = pem.partition(_ENCRYPTED)
    text, _, after = text.partition(_END)
    if b"-----" in before + after:
        raise ValueError("more than one key")
    encrypted = base64.b64decode(b"".join(text.split()), validate=True)
    pbes2.check_cost(encrypted)
    return load_der_private_key(encrypted, passphrase.encode())


def _to_pem(key: ec.EllipticCurvePrivateKey, passphrase: str | None) -> bytes:
    if passphrase is None:
        return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    if not passphrase:
        raise PassphraseRefused("the passphrase is empty", "choose one, or ask for none explicitly")
    plain = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    salt, iv = secrets.token_bytes(pbes2.SALT_SIZE), secrets.token_bytes(pbes2.IV_SIZE)
    text = base64.b64encode(pbes2.encrypt(plain, passphrase.encode(), salt=salt, iv=iv))
    lines = [text[start : start + 64] for start in range(0, len(text), 64)]
    return b"\n".join([_ENCRYPTED, *lines, _END, b""])


def _write_durably(descriptor: int, data: bytes, directory: Path) -> None:
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    _sync_directory(directory)


def _sync_directory(directory: Path) -> None:
    """Make a new directory entry durable."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _read(path: Path) -> bytes:
    ownership.check_directory(path.parent)
    try:
        descriptor = os.open(path, _READ)
    except FileNotFoundError:
        raise KeyRefused(f"there is no key at {path}", "create one with rossec") from None
    except OSError as error:
        raise KeyRefused(
            f"cannot open {path}: {error.strerror}",
            "a key file must be a regular file of the user rossec runs as, not a symbolic link",
        ) from error
    with os.fdopen(descriptor, "rb") as file:
        _check_file(path, os.fstat(file.fileno()))
        return file.read(_MAX_FILE)


def _check_file(path: Path, status: os.stat_result) -> None:
    """Check the opened file, not the path, which may have been replaced meanwhile."""
    if not stat.S_ISREG(status.st_mode):
        raise KeyRefused(f"{path} is not a regular file", "name the file of the private key")
    if status.st_mode & 0o077:
        raise KeyRefused(
            f"{path} can be read or written by others",
            f"if nobody used that: chmod 600 {path}; otherwise make a new key",
        )
    ownership.check_file(path, status)
    if status.st_size > _MAX_FILE:
        raise KeyRefused(f"{path} is too large for a key", "name the file of the private key")


def _check_passphrase(path: Path, passphrase: str | None, *, encrypted: bool) -> None:
    if encrypted and passphrase is None:
        raise PassphraseRefused(f"{path} is encrypted", "give its passphrase")
    if passphrase is not None and not encrypted:
        raise PassphraseRefused(
            f"{path} is not encrypted although a passphrase was given",
            "find out who replaced the file, or leave the passphrase out",
        )
