import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed25519

from ca.errors import KeyRefused
from ca.keys.signing import from_coordinates, require_p256, thumbprint, thumbprint_of, to_coordinates


def test_thumbprint_of_rfc_9679() -> None:
    """The worked example of RFC 9679, section 6."""
    x = int("65eda5a12577c2bae829437fe338701a10aaa375e1bb5b5de108de439c08551d", 16)
    y = int("1e52ed75701163f7f9e40ddf9f341b3dc9ba860af7e0ca7ca7e9eecd0084d19c", 16)
    key = ec.EllipticCurvePublicNumbers(x, y, ec.SECP256R1()).public_key()
    assert thumbprint(key).hex() == "496bd8afadf307e5b08c64b0421bf9dc01528a344a43bda88fadd1669da253ec"


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


def test_coordinates_name_a_key_and_its_thumbprint() -> None:
    key = ec.generate_private_key(ec.SECP256R1()).public_key()
    data = to_coordinates(key)
    assert from_coordinates(data) == key
    assert thumbprint_of(data) == thumbprint(key)


@pytest.mark.parametrize("size", [0, 63, 65])
def test_coordinates_of_another_length_are_refused(size: int) -> None:
    for read in (from_coordinates, thumbprint_of):
        with pytest.raises(KeyRefused, match="wrong length"):
            read(bytes(size))


def test_coordinates_off_the_curve_are_no_key() -> None:
    with pytest.raises(KeyRefused, match="not a point"):
        from_coordinates(bytes(64))
