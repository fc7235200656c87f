from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from ca.keys.signing import KeySigner, Signer


def test_signs_es256_in_raw_form() -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    signer: Signer = KeySigner(key)
    signature = signer.sign(b"message")
    assert len(signature) == 64
    r, s = int.from_bytes(signature[:32]), int.from_bytes(signature[32:])
    der = encode_dss_signature(r, s)
    signer.public_key.verify(der, b"message", ec.ECDSA(hashes.SHA256()))
    assert signer.public_key == key.public_key()


def test_short_numbers_are_padded() -> None:
    """One signature in 128 has a leading zero octet in r or s; the length stays."""
    signer = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    assert {len(signer.sign(bytes([n % 256]))) for n in range(400)} == {64}


def test_the_key_is_not_on_show() -> None:
    signer = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    assert not hasattr(signer, "__dict__")
    assert repr(signer) == object.__repr__(signer)
