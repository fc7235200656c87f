"""A P-256 key in a PKCS#11 token: a `Signer` that uses the key without reading it.

This module does I/O, and is the only one that uses python-pkcs11 (the extra `hsm`). A key is named
by a URI of RFC 7512, `pkcs11:token=T;object=O?module-path=/path/to.so`; a PIN in it is refused, as
URIs are written to files and logs. Keys created here are generated in the token, not extractable.
"""

import hashlib
import os
import urllib.parse
from dataclasses import dataclass
from typing import Any, Final, Self

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import KeyRefused, TokenRefused
from ca.keys.publickey import require_p256

SCHEME: Final = "pkcs11:"
DEFAULT_MODULE: Final = "/usr/lib/softhsm/libsofthsm2.so"
_INSTALL_HINT: Final = "install it: pip install 'rossec[hsm]'"
_OCTET_STRING: Final = b"\x04\x41"  # CKA_EC_POINT is the point inside an OCTET STRING
_LIST_HINT: Final = "list tokens and keys with: pkcs11-tool --list-token-slots --list-objects"


@dataclass(frozen=True)
class KeyUri:
    """Where a key is: the label of the token, that of the object, and the PKCS#11 module."""

    token: str
    object: str
    module: str

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a URI.

        Raises:
            TokenRefused: not of this form, or it contains a PIN.
        """
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
        self._public_key = public_key

    @classmethod
    def open(cls, uri: KeyUri, pin: str) -> Self:
        """Log in and find the key.

        Raises:
            TokenRefused: no such token or key, or the PIN is wrong.
            KeyRefused: not a P-256 key, or an extractable one.
        """
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
        if extractable:
            raise KeyRefused(
                f"the key {uri.object} is extractable from its token",
                "create one that is not",
            )
        return cls(session, key, _public(uri, point))

    @classmethod
    def create(cls, uri: KeyUri, pin: str) -> Self:
        """Generate a new key in the token.

        Raises:
            TokenRefused: no such token, the PIN is wrong, or the label is in use.
        """
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
                private_template={
                    pkcs11.Attribute.SENSITIVE: True,
                    pkcs11.Attribute.EXTRACTABLE: False,
                },
            )
        except pkcs11.exceptions.PKCS11Error as error:
            raise TokenRefused(
                f"the token {uri.token} cannot generate a P-256 key{_reason(error)}", _LIST_HINT
            ) from error
        session.close()
        return cls.open(uri, pin)

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The public key."""
        return self._public_key

    def sign(self, message: bytes) -> bytes:
        """ES256 over `message`: 64 bytes, r || s (RFC 9053 section 2.1).

        Raises:
            TokenRefused: the token was removed, or refuses.
        """
        pkcs11 = _library()
        try:
            # CKM_ECDSA takes the digest: the token need not support hashing.
            digest = hashlib.sha256(message).digest()
            return bytes(self._key.sign(digest, mechanism=pkcs11.Mechanism.ECDSA))
        except pkcs11.exceptions.PKCS11Error as error:
            raise TokenRefused(f"the token does not sign{_reason(error)}", _LIST_HINT) from error

    def close(self) -> None:
        """Log out."""
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
        return _log_in(pkcs11.lib(uri.module).get_token(token_label=uri.token), pin)
    except pkcs11.exceptions.NoSuchToken as error:
        raise TokenRefused(f"there is no token {uri.token}", _LIST_HINT) from error
    except pkcs11.exceptions.PinIncorrect as error:
        raise TokenRefused(
            f"the PIN does not open the token {uri.token}",
            "caution: tokens lock after a few wrong PINs",
        ) from error
    except pkcs11.exceptions.PKCS11Error as error:
        raise TokenRefused(
            f"the token {uri.token} cannot be opened{_reason(error)}", _LIST_HINT
        ) from error


def _log_in(token: Any, pin: str) -> Any:
    """A token has one login per process: after the first one, sessions need no PIN."""
    try:
        return token.open(rw=True, user_pin=pin)
    except _library().exceptions.UserAlreadyLoggedIn:
        return token.open(rw=True)


def _public(uri: KeyUri, point: bytes) -> ec.EllipticCurvePublicKey:
    if not point.startswith(_OCTET_STRING):
        raise KeyRefused(
            f"the key {uri.object} is not a P-256 key", "make one with rossec ca init DOMAIN"
        )
    try:
        return require_p256(ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), point[2:]))
    except ValueError as error:
        raise KeyRefused(
            f"the key {uri.object} is not a P-256 key", "make one with rossec ca init DOMAIN"
        ) from error


def _fields(text: str, separator: str) -> dict[str, str]:
    """Attributes of RFC 7512, percent-decoded; none if one is repeated."""
    pairs = [part.partition("=") for part in text.split(separator) if part]
    names = [name for name, _, _ in pairs]
    if len(set(names)) != len(names):
        return {}
    return {name: urllib.parse.unquote(value) for name, _, value in pairs}


def _reason(error: Exception) -> str:
    return f": {type(error).__name__}"
