import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed25519

from ca.errors import KeyRefused
from ca.keys.publickey import require_p256, thumbprint


def test_thumbprint_of_rfc_9679() -> None:
    """The worked example of RFC 9679, section 6."""
    x = int("65eda5a12577c2bae829437fe338701a10aaa375e1bb5b5de108de439c08551d", 16)
    y = int("1e52ed75701163f7f9e40ddf9f341b3dc9ba860af7e0ca7ca7e9eecd0084d19c", 16)
    key = ec.EllipticCurvePublicNumbers(x, y, ec.SECP256R1()).public_key()
    assert (
        thumbprint(key).hex() == "496bd8afadf307e5b08c64b0421bf9dc01528a344a43bda88fadd1669da253ec"
    )


@pytest.mark.parametrize(
    "key",
    [
        ec.generate_private_key(ec.SECP384R1()).public_key(),
        ec.generate_private_key(ec.SECP256K1()).public_key(),
        ed25519.Ed25519PrivateKey.generate().public_key(),
        ec.generate_private_key(ec.SECP256R1()),
        None,
    ],
)
def test_only_p256_public_keys(key: object) -> None:
    with pytest.raises(KeyRefused, match="the key is not a P-256 key"):
        require_p256(key)


def test_a_p256_key_passes() -> None:
    key = ec.generate_private_key(ec.SECP256R1()).public_key()
    assert require_p256(key) is key
