import subprocess

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_der_private_key,
)

from ca.errors import KeyRefused
from ca.keys import passphrases

PASSPHRASE = b"correct horse"
KEY = ec.generate_private_key(ec.SECP256R1())
PLAIN = KEY.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
ENCRYPTED = passphrases.encrypt(PLAIN, PASSPHRASE, salt=bytes(range(16)), iv=bytes(range(16, 32)))


def test_cryptography_reads_it() -> None:
    key = load_der_private_key(ENCRYPTED, PASSPHRASE)
    assert key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption()) == PLAIN


def test_openssl_reads_it() -> None:
    done = subprocess.run(
        ["openssl", "pkey", "-inform", "DER", "-outform", "DER", "-passin", "pass:correct horse"],
        input=ENCRYPTED,
        capture_output=True,
        check=True,
    )
    assert ec.SECP256R1.name.encode() not in done.stderr
    same = load_der_private_key(done.stdout, None)
    assert same.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption()) == PLAIN


def test_the_parameters_are_the_promised_ones() -> None:
    done = subprocess.run(
        ["openssl", "asn1parse", "-inform", "DER"], input=ENCRYPTED, capture_output=True, check=True
    )
    lines = done.stdout.decode()
    for wanted in ("PBES2", "scrypt", "INTEGER           :4000", "aes-256-cbc"):
        assert wanted in lines
    assert lines.count("INTEGER           :08") == 2


@pytest.mark.parametrize("size", [0, 15, 16, 200, 70_000])
def test_every_length_form(size: int) -> None:
    blob = passphrases.encrypt(bytes(size), b"x", salt=bytes(16), iv=bytes(16))
    done = subprocess.run(
        ["openssl", "asn1parse", "-inform", "DER"], input=blob, capture_output=True, check=False
    )
    assert done.returncode == 0


def asking(*costs: int, derivation: bytes = passphrases._OID_SCRYPT) -> bytes:
    """An encrypted key whose file asks for these costs; nothing was derived."""
    salt = passphrases.der(passphrases._OCTETS, bytes(16))
    parameters = passphrases.der(passphrases.SEQUENCE, salt, *map(passphrases._integer, costs))
    encryption = passphrases.der(
        passphrases.SEQUENCE, passphrases._OID_AES256_CBC, passphrases.der(passphrases._OCTETS, bytes(16))
    )
    both = passphrases.der(
        passphrases.SEQUENCE, passphrases.der(passphrases.SEQUENCE, derivation, parameters), encryption
    )
    algorithm = passphrases.der(passphrases.SEQUENCE, passphrases._OID_PBES2, both)
    return passphrases.der(passphrases.SEQUENCE, algorithm, passphrases.der(passphrases._OCTETS, bytes(160)))


def test_what_rossec_and_openssl_write_costs_no_more_than_is_allowed() -> None:
    passphrases.check_cost(ENCRYPTED)
    command = ["openssl", "pkcs8", "-topk8", "-inform", "DER", "-outform", "DER"]
    for how in (["-scrypt"], ["-v2", "aes-256-cbc", "-iter", "600000"]):
        done = subprocess.run(
            [*command, *how, "-passout", "pass:x"], input=PLAIN, capture_output=True, check=True
        )
        passphrases.check_cost(done.stdout)


@pytest.mark.parametrize(
    "costs",
    [
        (2**14, 8, 5000),
        (2**30, 8, 1),
        (2**14, 2**20, 1),
        (2**14, 8, 33),
        (2**64, 1, 1),
        (0, 8, 1),
        (2**14, 8, -1),
    ],
)
def test_a_key_that_costs_too_much_is_refused(costs: tuple[int, ...]) -> None:
    with pytest.raises(KeyRefused, match="more work"):
        passphrases.check_cost(asking(*costs))


@pytest.mark.parametrize("iterations", [4_000_001, 2**31, 0])
def test_iterations_are_bounded_too(iterations: int) -> None:
    passphrases.check_cost(asking(4_000_000, derivation=passphrases._OID_PBKDF2))
    with pytest.raises(KeyRefused, match="more work"):
        passphrases.check_cost(asking(iterations, derivation=passphrases._OID_PBKDF2))


def test_nothing_but_der_of_these_is_read() -> None:
    other = ENCRYPTED.replace(passphrases._OID_SCRYPT, passphrases._OID_SCRYPT[:-1] + b"\x0c")
    longer = ENCRYPTED[:1] + b"\x83\x00" + ENCRYPTED[2:]
    for data in (other, longer, ENCRYPTED + b"\x00", b"", b"\x30", b"\x30\x80\x00\x00", PLAIN):
        with pytest.raises(ValueError, match=r"DER|element|algorithm"):
            passphrases.check_cost(data)
    for end in range(len(ENCRYPTED)):
        with pytest.raises(ValueError, match=r"DER|element|algorithm"):
            passphrases.check_cost(ENCRYPTED[:end])
