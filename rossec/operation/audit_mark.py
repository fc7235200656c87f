"""The first line of an audit file: signed with the master's key. Pure.

The hash chain shows what is missing between two lines, not what is missing before the first. So
each file begins with a line that names the hash from which it continues, or none in the very first
file. Only the master can sign it: without the beginning of a file it is missing, too, and cannot be
forged. A file that was removed is detected by the hash that the next one names.
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
    """The first line of a file, without its hash; `before` is the hash it continues from."""
    text = _FIRST_FILE if before == FIRST else _NEXT_FILE
    point = signer.public_key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
    entry: Entry = {"at": at, "before": before, "level": "info", "text": text, _KEY: point.hex()}
    return {**entry, _SIGNATURE: signer.sign(_signed(entry)).hex()}


def check_beginning(first: Entry, key: bytes | None = None, after: str | None = None) -> str:
    """Check the beginning of an audit; returns a remark, empty when it is complete.

    Args:
        first: the first line, whose hash was verified.
        key: thumbprint of the master's key, if it is known.
        after: the hash of the line before, if it is known.

    Raises:
        ConfigurationError: the beginning is missing or forged.
    """
    before = first.get("before")
    if _SIGNATURE in first:
        signed_by = _key_of(first)
        if key is not None and signed_by != key:
            raise ConfigurationError(
                f"the audit begins with a line of another key, {signed_by.hex()}",
                "if the master had that key then, name it with --key",
            )
        unknown = "" if key is not None else f"; the key {signed_by.hex()} is not known here"
        complete = before in {FIRST, after}
        return (
            f"{'' if complete else f'it continues from {before}, not among these files'}{unknown}"
        )
    if before == after:
        return ""
    if before == FIRST:
        return "its first line is not signed: it is of an older version"
    raise ConfigurationError("the beginning of the audit is missing", _HINT)


def _key_of(entry: Entry) -> bytes:
    """The thumbprint of the key that signed the entry."""
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
