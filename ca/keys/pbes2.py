"""A PKCS#8 private key encrypted with PBES2: scrypt, then AES-256-CBC (RFC 7914 section 7).

`cryptography` reads this form but cannot write it: its `BestAvailableEncryption` is PBKDF2 with
2048 iterations, 4 ms a guess. The cost here is half a second. N stays at 2^14 because OpenSSL 3.0
refuses scrypt beyond 32 MiB; p makes up for it. PKCS#8 readers support only CBC without a MAC: a
damaged file fails at its padding or its structure, and does not become another usable key.

A key file says itself what trying a passphrase costs. One in a backup is its maker's: that is read
and bounded first.
"""

from typing import Final

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt
from cryptography.hazmat.primitives.padding import PKCS7

from ca.errors import KeyRefused

SALT_SIZE: Final = 16
IV_SIZE: Final = 16
_N, _R, _P = 2**14, 8, 8
_KEY_SIZE: Final = 32
_MAX_MEMORY: Final = 2**26  # bytes, four times ours
_MAX_WORK: Final = 2**22  # N r p, four times ours
_MAX_ITERATIONS: Final = 4_000_000  # of PBKDF2: OWASP asks for 600,000 of SHA-256

_INTEGER, _OCTETS, _SEQUENCE = 0x02, 0x04, 0x30
_OID_PBES2: Final = bytes.fromhex("06092a864886f70d01050d")  # 1.2.840.113549.1.5.13
_OID_SCRYPT: Final = bytes.fromhex("06092b06010401da47040b")  # 1.3.6.1.4.1.11591.4.11
_OID_PBKDF2: Final = bytes.fromhex("06092a864886f70d01050c")  # 1.2.840.113549.1.5.12
_OID_AES256_CBC: Final = bytes.fromhex("060960864801650304012a")  # 2.16.840.1.101.3.4.1.42


def encrypt(private_key_info: bytes, passphrase: bytes, *, salt: bytes, iv: bytes) -> bytes:
    """Return the DER `EncryptedPrivateKeyInfo` of a DER `PrivateKeyInfo`.

    `salt` and `iv` are 16 random bytes each, never used before.
    """
    key = Scrypt(salt=salt, length=_KEY_SIZE, n=_N, r=_R, p=_P).derive(passphrase)
    return _der(_SEQUENCE, _algorithm(salt, iv), _der(_OCTETS, _cbc(key, iv, private_key_info)))


def check_cost(encrypted: bytes) -> None:
    """Return if opening the DER `EncryptedPrivateKeyInfo` takes no more than is of use.

    Raises:
        ValueError: not the DER of PBES2 with scrypt or PBKDF2 (RFC 8018, appendix A).
        KeyRefused: it asks for more.
    """
    body = _only(encrypted, _SEQUENCE)
    algorithm, secret = _read(body, _SEQUENCE)
    _only(secret, _OCTETS)
    parameters = _only(_after(_OID_PBES2, algorithm), _SEQUENCE)
    derivation, encryption = _read(parameters, _SEQUENCE)
    _only(encryption, _SEQUENCE)
    is_scrypt = derivation.startswith(_OID_SCRYPT)
    asked = _after(_OID_SCRYPT if is_scrypt else _OID_PBKDF2, derivation)
    _, rest = _read(_only(asked, _SEQUENCE), _OCTETS)
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


def _algorithm(salt: bytes, iv: bytes) -> bytes:
    parameters = _der(_SEQUENCE, _der(_OCTETS, salt), *map(_integer, (_N, _R, _P, _KEY_SIZE)))
    derivation = _der(_SEQUENCE, _OID_SCRYPT, parameters)
    encryption = _der(_SEQUENCE, _OID_AES256_CBC, _der(_OCTETS, iv))
    return _der(_SEQUENCE, _OID_PBES2, _der(_SEQUENCE, derivation, encryption))


def _cbc(key: bytes, iv: bytes, plain: bytes) -> bytes:
    padder = PKCS7(algorithms.AES.block_size).padder()
    encryptor = Cipher(algorithms.AES(key), modes.CBC(iv)).encryptor()
    padded = padder.update(plain) + padder.finalize()
    return encryptor.update(padded) + encryptor.finalize()


def _integer(value: int) -> bytes:
    return _der(_INTEGER, value.to_bytes(value.bit_length() // 8 + 1, signed=True))


def _der(tag: int, *contents: bytes) -> bytes:
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
    """The content of the one element that `data` is."""
    content, rest = _read(data, tag)
    if rest:
        raise ValueError("more than one element")
    return content


def _read(data: bytes, tag: int) -> tuple[bytes, bytes]:
    """The content of the first element, which has this tag, and what follows it."""
    if len(data) < 2 or data[0] != tag:
        raise ValueError("another element")
    size, begin = data[1], 2
    if size & 0x80:
        begin += size & 0x7F
        size = int.from_bytes(data[2:begin])
    content = data[begin : begin + size]
    if data[: begin + size] != _der(tag, content):  # truncated, or not the shortest length
        raise ValueError("not DER")
    return content, data[begin + size :]
