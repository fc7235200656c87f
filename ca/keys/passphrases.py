"""Encryption under a passphrase: a private key as PBES2 (scrypt, AES-256-CBC), an authority's backup.

A backup is scrypt (RFC 7914), then AES-256-GCM over one deterministic CBOR map from file names to
contents.
"""

import re
from collections.abc import Mapping
from typing import Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt
from cryptography.hazmat.primitives.padding import PKCS7

from ca.encoding import decode, encode
from ca.errors import CAError, EncodingError, KeyRefused, PassphraseRefused

SALT_SIZE: Final = 16
IV_SIZE: Final = 16
_N, _R, _P = 2**14, 8, 8  # OpenSSL 3.0 refuses scrypt beyond 32 MiB: N stays small, p makes up for it
_KEY_SIZE: Final = 32
_MAX_MEMORY: Final = 2**26  # bytes, four times ours
_MAX_WORK: Final = 2**22  # N r p, four times ours
_MAX_ITERATIONS: Final = 4_000_000  # of PBKDF2: OWASP asks for 600,000 of SHA-256

_INTEGER, _OCTETS, SEQUENCE = 0x02, 0x04, 0x30  # of DER
_OID_PBES2: Final = bytes.fromhex("06092a864886f70d01050d")  # 1.2.840.113549.1.5.13
_OID_SCRYPT: Final = bytes.fromhex("06092b06010401da47040b")  # 1.3.6.1.4.1.11591.4.11
_OID_PBKDF2: Final = bytes.fromhex("06092a864886f70d01050c")  # 1.2.840.113549.1.5.12
_OID_AES256_CBC: Final = bytes.fromhex("060960864801650304012a")  # 2.16.840.1.101.3.4.1.42

MAGIC: Final = b"rossec-backup/1\n"
NONCE_SIZE: Final = 12
MAX_BACKUP: Final = 256 * 1024 * 1024
_HEAD: Final = len(MAGIC) + SALT_SIZE + NONCE_SIZE
_BACKUP_N, _BACKUP_R, _BACKUP_P = (2**15, 8, 3)  # OWASP's equivalent of 2^17, 8, 1 in a quarter of its memory
_DIRECTORIES: Final = ("node", "inbox")
_JOURNALS: Final = ("-journal", "-wal", "-shm")  # of SQLite, which applies them on opening
_SEGMENT: Final = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,254}"
_NAME: Final = re.compile(rf"(?:{_SEGMENT}/){{0,3}}{_SEGMENT}")


def encrypt(private_key_info: bytes, passphrase: bytes, *, salt: bytes, iv: bytes) -> bytes:
    """Return the DER `EncryptedPrivateKeyInfo` of a DER `PrivateKeyInfo`."""
    # `salt` and `iv` are 16 random bytes each, never used before.
    # `cryptography` reads this form but cannot write it: its `BestAvailableEncryption` is PBKDF2 with 2048
    # iterations, 4 ms a guess; here a guess takes half a second.
    key = Scrypt(salt=salt, length=_KEY_SIZE, n=_N, r=_R, p=_P).derive(passphrase)
    parameters = der(SEQUENCE, der(_OCTETS, salt), *map(_integer, (_N, _R, _P, _KEY_SIZE)))
    derivation = der(SEQUENCE, _OID_SCRYPT, parameters)
    encryption = der(SEQUENCE, _OID_AES256_CBC, der(_OCTETS, iv))
    algorithm = der(SEQUENCE, _OID_PBES2, der(SEQUENCE, derivation, encryption))
    # PKCS#8 readers support only CBC without a MAC: a damaged file fails at its padding or its
    # structure, and does not become another usable key.
    padder, encryptor = PKCS7(128).padder(), Cipher(algorithms.AES(key), modes.CBC(iv)).encryptor()
    padded = padder.update(private_key_info) + padder.finalize()
    return der(SEQUENCE, algorithm, der(_OCTETS, encryptor.update(padded) + encryptor.finalize()))


def check_cost(encrypted: bytes) -> None:
    # A key file says itself what trying a passphrase costs, so that is read and bounded first: hours, or all
    # memory, would be the price of opening somebody else's file.
    body = _only(encrypted, SEQUENCE)
    algorithm, secret = _read(body, SEQUENCE)
    _only(secret, _OCTETS)
    parameters = _only(_after(_OID_PBES2, algorithm), SEQUENCE)
    derivation, encryption = _read(parameters, SEQUENCE)
    _only(encryption, SEQUENCE)
    is_scrypt = derivation.startswith(_OID_SCRYPT)
    asked = _after(_OID_SCRYPT if is_scrypt else _OID_PBKDF2, derivation)
    _, rest = _read(_only(asked, SEQUENCE), _OCTETS)
    costs = []
    for _ in range(3 if is_scrypt else 1):
        content, rest = _read(rest, _INTEGER)
        costs.append(int.from_bytes(content, signed=True))
    if is_scrypt:
        n, r, p = costs
        is_bounded = 128 * n * r <= _MAX_MEMORY and n * r * p <= _MAX_WORK
    else:
        is_bounded = costs[0] <= _MAX_ITERATIONS
    if min(costs) < 1 or not is_bounded:
        raise KeyRefused(
            "the key asks for more work than a passphrase is worth", "find out who made this file"
        )


def _integer(value: int) -> bytes:
    return der(_INTEGER, value.to_bytes(value.bit_length() // 8 + 1, signed=True))


def der(tag: int, *contents: bytes) -> bytes:
    """One element of DER (X.690 section 8.1.3) with these contents."""
    body = b"".join(contents)
    size = len(body)
    if size < 0x80:
        return bytes((tag, size)) + body
    octets = size.to_bytes((size.bit_length() + 7) // 8)
    return bytes((tag, 0x80 | len(octets))) + octets + body


def _after(beginning: bytes, data: bytes) -> bytes:
    if not data.startswith(beginning):
        raise ValueError("another algorithm")
    return data[len(beginning) :]


def _only(data: bytes, tag: int) -> bytes:
    content, rest = _read(data, tag)
    if rest:
        raise ValueError("more than one element")
    return content


def _read(data: bytes, tag: int) -> tuple[bytes, bytes]:
    if len(data) < 2 or data[0] != tag:
        raise ValueError("another element")
    size, begin = data[1], 2
    if size & 0x80:
        begin += size & 0x7F
        size = int.from_bytes(data[2:begin])
    content = data[begin : begin + size]
    if data[: begin + size] != der(tag, content):  # truncated, or not the shortest length
        raise ValueError("not DER")
    return content, data[begin + size :]


def seal(files: Mapping[str, bytes], passphrase: str, *, salt: bytes, nonce: bytes) -> bytes:
    """Return the backup of `files`; `salt` (16) and `nonce` (12) are random and never used before."""
    _check_names(files)
    head = MAGIC + salt + nonce
    plain = encode({str(name): data for name, data in files.items()})
    if len(plain) > MAX_BACKUP - 1024:
        raise CAError("the authority is too large for one backup")
    return head + AESGCM(_key(passphrase, salt)).encrypt(nonce, plain, head)


def unseal(data: bytes, passphrase: str) -> dict[str, bytes]:
    if len(data) > MAX_BACKUP or len(data) < _HEAD or not data.startswith(MAGIC):
        raise CAError("this is not a backup of an authority", "name the file that `rossec ca backup` wrote")
    head = data[:_HEAD]
    salt, nonce = head[len(MAGIC) : -NONCE_SIZE], head[-NONCE_SIZE:]
    try:
        plain = AESGCM(_key(passphrase, salt)).decrypt(nonce, data[_HEAD:], head)
    except InvalidTag:
        raise PassphraseRefused(
            "the passphrase does not open the backup",
            "try again; if it is certainly right, the file is damaged: take an older one",
        ) from None
    return _read_files(plain)


def _read_files(plain: bytes) -> dict[str, bytes]:
    try:
        value = decode(plain, limit=MAX_BACKUP)
    except EncodingError as error:
        raise CAError(f"the backup is malformed: {error}") from error
    if not isinstance(value, dict):
        raise CAError("the backup is malformed: no files in it")
    files = {str(name): item for name, item in value.items() if isinstance(item, bytes)}
    if len(files) != len(value):
        raise CAError("the backup is malformed: a file without content")
    _check_names(files)
    return files


def _check_names(files: Mapping[str, bytes]) -> None:
    # An untrusted name must not write outside the directory it is restored to, nor where SQLite would apply
    # it as a journal; and no name is both a file and a directory.
    parts = [name.split("/") for name in files]
    directories = {"/".join(each[:end]) for each in parts for end in range(1, len(each))}
    directories.update(_DIRECTORIES)
    for name in files:
        if _NAME.fullmatch(name) is None or name in directories or name.endswith(_JOURNALS):
            raise CAError(f"{name!a} is not a file of an authority")


def _key(passphrase: str, salt: bytes) -> bytes:
    if not passphrase:
        raise PassphraseRefused("the passphrase is empty", "choose one")
    return Scrypt(salt=salt, length=32, n=_BACKUP_N, r=_BACKUP_R, p=_BACKUP_P).derive(passphrase.encode())
