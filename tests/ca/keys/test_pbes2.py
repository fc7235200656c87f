import subprocess

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_der_private_key,
)

from ca.keys import pbes2

PASSPHRASE = b"correct horse"
KEY = ec.generate_private_key(ec.SECP256R1())
PLAIN = KEY.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
ENCRYPTED = pbes2.encrypt(PLAIN, PASSPHRASE, salt=bytes(range(16)), iv=bytes(range(16, 32)))


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
    blob = pbes2.encrypt(bytes(size), b"x", salt=bytes(16), iv=bytes(16))
    done = subprocess.run(
        ["openssl", "asn1parse", "-inform", "DER"], input=blob, capture_output=True, check=False
    )
    assert done.returncode == 0
