"""An authority's backup: its files in one, encrypted under a passphrase. Bytes in, bytes out.

scrypt (RFC 7914) derives the key from the passphrase, AES-256-GCM encrypts one deterministic CBOR
map from file names to contents; the header is authenticated data. A wrong passphrase and a changed
byte cannot be told apart. Names are restricted: an untrusted backup cannot write outside the
directory it is restored to, nor add a journal file that SQLite would apply to the record. Which
files an authority has, the parts say that own them (`rossec.authority.contents`).
"""

import re
from collections.abc import Mapping
from typing import Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from ca.encoding import decode, encode
from ca.errors import BackupRefused, EncodingError, PassphraseRefused

MAGIC: Final = b"rossec-backup/1\n"
SALT_SIZE: Final = 16
NONCE_SIZE: Final = 12
MAX_BACKUP: Final = 256 * 1024 * 1024
_HEAD: Final = len(MAGIC) + SALT_SIZE + NONCE_SIZE
_N, _R, _P = 2**15, 8, 3  # OWASP's equivalent of 2^17, 8, 1 in a quarter of its memory
_DIRECTORIES: Final = ("node", "inbox")
_JOURNALS: Final = ("-journal", "-wal", "-shm")  # of SQLite, which applies them on opening
_SEGMENT: Final = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,254}"
_NAME: Final = re.compile(rf"(?:{_SEGMENT}/){{0,3}}{_SEGMENT}")


def seal(files: Mapping[str, bytes], passphrase: str, *, salt: bytes, nonce: bytes) -> bytes:
    """Return the backup of `files`; `salt` (16) and `nonce` (12) are random and never used before.

    Raises:
        BackupRefused: a file name that is not allowed, or too much data.
        PassphraseRefused: the passphrase is empty.
    """
    _check_names(files)
    head = MAGIC + salt + nonce
    plain = encode({str(name): data for name, data in files.items()})
    if len(plain) > MAX_BACKUP - 1024:
        raise BackupRefused("the authority is too large for one backup")
    return head + AESGCM(_key(passphrase, salt)).encrypt(nonce, plain, head)


def unseal(data: bytes, passphrase: str) -> dict[str, bytes]:
    """Return the files in a backup.

    Raises:
        BackupRefused: not a backup, truncated, or too large.
        PassphraseRefused: the passphrase is wrong, or a byte was changed.
    """
    if len(data) > MAX_BACKUP or len(data) < _HEAD or not data.startswith(MAGIC):
        raise BackupRefused(
            "this is not a backup of an authority", "name the file that `rossec ca backup` wrote"
        )
    head = data[:_HEAD]
    salt, nonce = head[len(MAGIC) : -NONCE_SIZE], head[-NONCE_SIZE:]
    try:
        plain = AESGCM(_key(passphrase, salt)).decrypt(nonce, data[_HEAD:], head)
    except InvalidTag:
        raise PassphraseRefused(
            "the passphrase does not open the backup",
            "try again; if it is certainly right, the file is damaged: take an older one",
        ) from None
    return _read(plain)


def _read(plain: bytes) -> dict[str, bytes]:
    try:
        value = decode(plain, limit=MAX_BACKUP)
    except EncodingError as error:
        raise BackupRefused(f"the backup is malformed: {error}") from error
    if not isinstance(value, dict):
        raise BackupRefused("the backup is malformed: no files in it")
    files = {str(name): item for name, item in value.items() if isinstance(item, bytes)}
    if len(files) != len(value):
        raise BackupRefused("the backup is malformed: a file without content")
    _check_names(files)
    return files


def _check_names(files: Mapping[str, bytes]) -> None:
    parts = [name.split("/") for name in files]
    directories = {"/".join(each[:end]) for each in parts for end in range(1, len(each))}
    directories.update(_DIRECTORIES)
    for name in files:
        if _NAME.fullmatch(name) is None or name in directories or name.endswith(_JOURNALS):
            raise BackupRefused(f"{name!a} is not a file of an authority")


def _key(passphrase: str, salt: bytes) -> bytes:
    if not passphrase:
        raise PassphraseRefused("the passphrase is empty", "choose one")
    return Scrypt(salt=salt, length=32, n=_N, r=_R, p=_P).derive(passphrase.encode())
