import copy

import pytest
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from ca.keys.signing import KeySigner, X509Signer

SIGNER = KeySigner(ec.generate_private_key(ec.SECP256R1()))
ADAPTER = X509Signer(SIGNER)


@pytest.mark.parametrize("data", [b"tbs", bytearray(b"tbs"), memoryview(b"tbs")])
def test_signs_through_the_signer(data: bytes | bytearray | memoryview) -> None:
    signature = ADAPTER.sign(data, ec.ECDSA(hashes.SHA256()))
    ADAPTER.public_key().verify(signature, b"tbs", ec.ECDSA(hashes.SHA256()))
    assert ADAPTER.public_key() == SIGNER.public_key


def test_a_certificate_is_signed_with_sha256_alone() -> None:
    with pytest.raises(TypeError, match="a Signer signs with SHA-256 only"):
        ADAPTER.sign(b"tbs", ec.ECDSA(hashes.SHA384()))


def test_says_what_it_is() -> None:
    assert isinstance(ADAPTER.curve, ec.SECP256R1)
    assert ADAPTER.key_size == 256


def test_gives_nothing_away() -> None:
    with pytest.raises(NotImplementedError, match="a Signer only signs"):
        ADAPTER.exchange(ec.ECDH(), SIGNER.public_key)
    with pytest.raises(NotImplementedError, match="a Signer does not expose its key"):
        ADAPTER.private_numbers()
    with pytest.raises(NotImplementedError, match="a Signer does not expose its key"):
        ADAPTER.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def test_copies_are_the_same_signer() -> None:
    assert copy.copy(ADAPTER) is ADAPTER
    assert copy.deepcopy(ADAPTER) is ADAPTER
