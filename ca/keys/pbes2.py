"""Write a PKCS#8 private key encrypted with PBES2: scrypt, then AES-256-CBC (RFC 7914 section 7).

`cryptography` reads this form but cannot write it: its `BestAvailableEncryption` is PBKDF2 with
2048 iterations, 4 ms a guess. The cost here is half a second. N stays at 2^14 because OpenSSL 3.0
refuses scrypt beyond 32 MiB; p makes up for it. PKCS#8 readers support only CBC without a MAC: a
damaged file fails at its padding or its structure, and does not become another usable key.
"""

from typing import Final

from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt
from cryptography.hazmat.primitives.padding import PKCS7

SALT_SIZE: Final = 16
IV_SIZE: Final = 16
_N, _R, _P = 2**14, 8, 8
_KEY_SIZE: Final = 32

_INTEGER, _OCTETS, _SEQUENCE = 0x02, 0x04, 0x30
_OID_PBES2: Final = bytes.fromhex("06092a864886f70d01050d")  # 1.2.840.113549.1.5.13
_OID_SCRYPT: Final = bytes.fromhex("06092b06010401da47040b")  # 1.3.6.1.4.1.11591.4.11
_OID_AES256_CBC: Final = bytes.fromhex("060960864801650304012a")  # 2.16.840.1.101.3.4.1.42


def encrypt(private_key_info: bytes, passphrase: bytes, *, salt: bytes, iv: bytes) -> bytes:
    """Return the DER `EncryptedPrivateKeyInfo` of a DER `PrivateKeyInfo`.

    `salt` and `iv` are 16 random bytes each, never used before.
    """
    key = Scrypt(salt=salt, length=_KEY_SIZE, n=_N, r=_R, p=_P).derive(passphrase)
    return _der(_SEQUENCE, _algorithm(salt, iv), _der(_OCTETS, _cbc(key, iv, private_key_info)))


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
    return _der(_INTEGER, value.to_bytes(value.bit_length() // 8 + 1))


def _der(tag: int, *contents: bytes) -> bytes:
    body = b"".join(contents)
    size = len(body)
    if size < 0x80:
        return bytes((tag, size)) + body
    octets = size.to_bytes((size.bit_length() + 7) // 8)
    return bytes((tag, 0x80 | len(octets))) + octets + body
