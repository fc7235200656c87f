"""The line with which a file of the audit begins: signed with the master's key. Pure.

The chain of hashes shows what is missing between two lines, not what is missing before the first.
So each file begins with a line that says from which hash it goes on (the audit's very first from
none), and only the master can write it: whoever cuts off the beginning of a file cuts this off, and
cannot put another there. Parts that were removed whole are known by the hash it names.
"""

from typing import Any, Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.keys.publickey import thumbprint
from ca.keys.signer import Signer
from rossec.errors import ConfigurationError

FIRST: Final = "0" * 64
_KEY, _SIGNATURE = "key", "signature"
_FIRST_FILE: Final = "the audit begins"
_NEXT_FILE: Final = "the audit goes on in a new file"
_COORDINATE: Final = 32
_HINT: Final = (
    "name the parts before it, the oldest first; where they are gone, the last hash that you noted"
    " of them with --after"
)

Entry = dict[str, Any]


def mark(signer: Signer, before: str, at: float) -> Entry:
    """The line that begins a file, not yet chained; `before` is the hash it goes on from."""
    text = _FIRST_FILE if before == FIRST else _NEXT_FILE
    point = signer.public_key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
    entry: Entry = {"at": at, "before": before, "level": "info", "text": text, _KEY: point.hex()}
    return {**entry, _SIGNATURE: signer.sign(_signed(entry)).hex()}


def check_beginning(first: Entry, key: bytes | None = None, after: str | None = None) -> str:
    """Return what is to be said of how an audit begins: a line, empty when it is whole.

    Args:
        first: its first line, as the chain found it unchanged.
        key: thumbprint of the master's key, if it is known.
        after: the hash that is known to come before.

    Raises:
        ConfigurationError: its beginning is missing, or somebody else wrote it.
    """
    before = first.get("before")
    if _SIGNATURE in first:
        begun = _key_of(first)
        if key is not None and begun != key:
            raise ConfigurationError(
                f"the audit begins with a line of another key, {begun.hex()}",
                "if the master had that key then, say so: --key",
            )
        unknown = "" if key is not None else f"; whose key {begun.hex()} is, is not known here"
        whole = before in {FIRST, after}
        return f"{'' if whole else f'it goes on from {before}, not among these files'}{unknown}"
    if before == after:
        return ""
    if before == FIRST:
        return "its first line is not signed: an older master began it"
    raise ConfigurationError("the beginning of the audit is missing", _HINT)


def _key_of(entry: Entry) -> bytes:
    """The thumbprint of the key that signed it."""
    try:
        key = ec.EllipticCurvePublicKey.from_encoded_point(
            ec.SECP256R1(), bytes.fromhex(entry[_KEY])
        )
        raw = bytes.fromhex(entry[_SIGNATURE])
        r, s = (int.from_bytes(half) for half in (raw[:_COORDINATE], raw[_COORDINATE:]))
        key.verify(encode_dss_signature(r, s), _signed(entry), ec.ECDSA(hashes.SHA256()))
    except (InvalidSignature, ValueError, TypeError, KeyError) as error:
        raise ConfigurationError("the first line of the audit is forged", _HINT) from error
    return thumbprint(key)


def _signed(entry: Entry) -> bytes:
    return "\n".join(
        ("rossec audit, a file begins", str(entry["before"]), str(entry["at"]), str(entry["text"]))
    ).encode()
