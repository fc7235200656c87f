"""Private keys, in files and in PKCS#11 tokens. Does I/O and uses system randomness.

A file is PKCS#8 in PEM, never overwritten, never printed. A key in a token is used without reading it,
and named by a URI of RFC 7512, `pkcs11:token=T;object=O?module-path=/path/to.so`.
"""

import base64
import hashlib
import os
import secrets
import stat
import urllib
import urllib.parse
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

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

from ca.errors import KeyRefused, PassphraseRefused, TokenRefused
from ca.keys import ownership, passphrases
from ca.keys.signing import require_p256

_MAX_FILE: Final = 8 * 1024
_ENCRYPTED: Final = b"-----BEGIN ENCRYPTED PRIVATE KEY-----"
_END: Final = _ENCRYPTED.replace(b"BEGIN", b"END")
# O_NONBLOCK: opening a FIFO must not hang; it is refused afterwards, as not a regular file.
_READ: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC

SCHEME: Final = "pkcs11:"
DEFAULT_MODULE: Final = "/usr/lib/softhsm/libsofthsm2.so"
_INSTALL_HINT: Final = "install it: pip install 'rossec[hsm]'"
_OCTET_STRING: Final = b"\x04\x41"  # CKA_EC_POINT is the point inside an OCTET STRING
_LIST_HINT: Final = "list tokens and keys with: pkcs11-tool --list-token-slots --list-objects"


def generate() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def write_private(path: Path, key: ec.EllipticCurvePrivateKey, passphrase: str | None = None) -> None:
    if passphrase is None:
        pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    elif not passphrase:
        raise PassphraseRefused("the passphrase is empty", "choose one, or ask for none explicitly")
    else:
        plain = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
        salt, iv = secrets.token_bytes(passphrases.SALT_SIZE), secrets.token_bytes(passphrases.IV_SIZE)
        text = base64.b64encode(passphrases.encrypt(plain, passphrase.encode(), salt=salt, iv=iv))
        lines = [text[start : start + 64] for start in range(0, len(text), 64)]
        pem = b"\n".join([_ENCRYPTED, *lines, _END, b""])
    try:
        # The mode is given at creation: with a chmod afterwards it would be readable for a moment.
        descriptor = os.open(path, _CREATE, 0o600)
    except FileExistsError:
        raise KeyRefused(
            f"{path} exists and is not overwritten", "move the old key away if it is not needed"
        ) from None
    except OSError as error:
        raise KeyRefused(f"cannot create {path}: {error.strerror}") from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(pem)
            file.flush()
            os.fsync(file.fileno())
        # The name too must survive a power failure: the identity for this key is asked for next.
        directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise KeyRefused(
            f"cannot write {path}: {error.strerror}", "no key was created: make room, then try again"
        ) from error


def load_private(path: Path, passphrase: str | None = None) -> ec.EllipticCurvePrivateKey:
    pem = _read(path)
    encrypted = _ENCRYPTED in pem
    if encrypted and passphrase is None:
        raise PassphraseRefused(f"{path} is encrypted", "give its passphrase")
    if passphrase is not None and not encrypted:
        raise PassphraseRefused(
            f"{path} is not encrypted although a passphrase was given",
            "find out who replaced the file, or leave the passphrase out",
        )
    try:
        key = load_pem_private_key(pem, None) if passphrase is None else _open(pem, passphrase)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        if passphrase is not None:
            raise PassphraseRefused(
                f"the passphrase does not open {path}",
                "try again; if it is certainly right, the file is damaged: restore the backup",
            ) from error
        raise KeyRefused(f"{path} holds no private key", "restore the file from a backup") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise KeyRefused(f"{path} holds a key that is not P-256", "create a new key with rossec")
    return key


def _open(pem: bytes, passphrase: str) -> PrivateKeyTypes:
    before, _, text = pem.partition(_ENCRYPTED)
    text, _, after = text.partition(_END)
    if b"-----" in before + after:
        raise ValueError("more than one key")
    encrypted = base64.b64decode(b"".join(text.split()), validate=True)
    passphrases.check_cost(encrypted)
    return load_der_private_key(encrypted, passphrase.encode())


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
        status = os.fstat(file.fileno())
        # Check the opened file, not the path, which may have been replaced meanwhile.
        if not stat.S_ISREG(status.st_mode):
            raise KeyRefused(f"{path} is not a regular file", "name the file of the private key")
        # As by ssh: a key that others can read must be assumed to be copied.
        if status.st_mode & 0o077:
            raise KeyRefused(
                f"{path} can be read or written by others",
                f"if nobody used that: chmod 600 {path}; otherwise make a new key",
            )
        ownership.check_file(path, status)
        if status.st_size > _MAX_FILE:
            raise KeyRefused(f"{path} is too large for a key", "name the file of the private key")
        return file.read(_MAX_FILE)


@dataclass(frozen=True)
class KeyUri:
    """Where a key is: the label of the token, that of the object, and the PKCS#11 module."""

    token: str
    object: str
    module: str

    @classmethod
    def parse(cls, text: str) -> Self:
        path, _, query = text.removeprefix(SCHEME).partition("?")
        path_fields, query_fields = _fields(path, ";"), _fields(query, "&")
        if "pin-value" in query_fields:
            raise TokenRefused(
                "a PIN in the URI would end in files and logs", "leave it out: it is asked for"
            )
        known = set(path_fields) == {"token", "object"} and set(query_fields) <= {"module-path"}
        if not text.startswith(SCHEME) or not known or not all(path_fields.values()):
            raise TokenRefused(
                f"{text!a} does not name a key in a token",
                "write it as pkcs11:token=LABEL;object=LABEL?module-path=/path/to/module.so",
            )
        module = query_fields.get("module-path", DEFAULT_MODULE)
        return cls(path_fields["token"], path_fields["object"], module)

    def __str__(self) -> str:
        token, label, module = (
            urllib.parse.quote(part, safe="/") for part in (self.token, self.object, self.module)
        )
        return f"{SCHEME}token={token};object={label}?module-path={module}"


class TokenSigner:
    """A `Signer` for a key in a token, with an open session."""

    def __init__(self, session: Any, key: Any, public_key: ec.EllipticCurvePublicKey) -> None:
        self._session = session
        self._key = key
        self.public_key = public_key

    @classmethod
    def open(cls, uri: KeyUri, pin: str) -> Self:
        session = _session(uri, pin)
        pkcs11 = _library()
        try:
            key = session.get_key(object_class=pkcs11.ObjectClass.PRIVATE_KEY, label=uri.object)
            public = session.get_key(object_class=pkcs11.ObjectClass.PUBLIC_KEY, label=uri.object)
            extractable = bool(key[pkcs11.Attribute.EXTRACTABLE])
            point = bytes(public[pkcs11.Attribute.EC_POINT])
        except pkcs11.exceptions.PKCS11Error as error:
            raise TokenRefused(
                f"the token {uri.token} has no usable key {uri.object}{_reason(error)}", _LIST_HINT
            ) from error
        # A token is there so that the key cannot be copied; this one can be.
        if extractable:
            raise KeyRefused(f"the key {uri.object} is extractable from its token", "create one that is not")
        wrong = f"the key {uri.object} is not a P-256 key", "make one with rossec ca init DOMAIN"
        if not point.startswith(_OCTET_STRING):
            raise KeyRefused(*wrong)
        try:
            found = require_p256(ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), point[2:]))
        except ValueError as error:
            raise KeyRefused(*wrong) from error
        return cls(session, key, found)

    @classmethod
    def create(cls, uri: KeyUri, pin: str) -> Self:
        session = _session(uri, pin)
        pkcs11 = _library()
        from pkcs11.util.ec import encode_named_curve_parameters  # noqa: PLC0415  (an extra)

        if list(session.get_objects({pkcs11.Attribute.LABEL: uri.object})):
            raise TokenRefused(
                f"the token {uri.token} already has an object called {uri.object}",
                "choose another label for the key; nothing in a token is overwritten",
            )
        try:
            session.create_domain_parameters(
                pkcs11.KeyType.EC,
                {pkcs11.Attribute.EC_PARAMS: encode_named_curve_parameters("secp256r1")},
                local=True,
            ).generate_keypair(
                store=True,
                label=uri.object,
                private_template={pkcs11.Attribute.SENSITIVE: True, pkcs11.Attribute.EXTRACTABLE: False},
            )
        except pkcs11.exceptions.PKCS11Error as error:
            raise TokenRefused(
                f"the token {uri.token} cannot generate a P-256 key{_reason(error)}", _LIST_HINT
            ) from error
        session.close()
        return cls.open(uri, pin)

    def sign(self, message: bytes) -> bytes:
        pkcs11 = _library()
        try:
            # CKM_ECDSA takes the digest: the token need not support hashing.
            digest = hashlib.sha256(message).digest()
            return bytes(self._key.sign(digest, mechanism=pkcs11.Mechanism.ECDSA))
        except pkcs11.exceptions.PKCS11Error as error:
            raise TokenRefused(f"the token does not sign{_reason(error)}", _LIST_HINT) from error

    def close(self) -> None:
        self._session.close()


def _library() -> Any:
    try:
        import pkcs11  # noqa: PLC0415  (an extra)
    except ImportError as error:
        raise TokenRefused("python-pkcs11 is not installed", _INSTALL_HINT) from error
    return pkcs11


def _session(uri: KeyUri, pin: str) -> Any:
    pkcs11 = _library()
    if not os.path.exists(uri.module):  # noqa: PTH110  (the module is loaded by this very path)
        raise TokenRefused(f"there is no PKCS#11 module at {uri.module}", "name it: ?module-path=")
    try:
        token = pkcs11.lib(uri.module).get_token(token_label=uri.token)
        try:
            return token.open(rw=True, user_pin=pin)
        except pkcs11.exceptions.UserAlreadyLoggedIn:
            return token.open(rw=True)
    except pkcs11.exceptions.NoSuchToken as error:
        raise TokenRefused(f"there is no token {uri.token}", _LIST_HINT) from error
    except pkcs11.exceptions.PinIncorrect as error:
        raise TokenRefused(
            f"the PIN does not open the token {uri.token}", "caution: tokens lock after a few wrong PINs"
        ) from error
    except pkcs11.exceptions.PKCS11Error as error:
        raise TokenRefused(f"the token {uri.token} cannot be opened{_reason(error)}", _LIST_HINT) from error


def _fields(text: str, separator: str) -> dict[str, str]:
    # Attributes of RFC 7512, percent-decoded; none if one is repeated.
    pairs = [part.partition("=") for part in text.split(separator) if part]
    names = [name for name, _, _ in pairs]
    if len(set(names)) != len(names):
        return {}
    return {name: urllib.parse.unquote(value) for name, _, value in pairs}


def _reason(error: Exception) -> str:
    return f": {type(error).__name__}"
