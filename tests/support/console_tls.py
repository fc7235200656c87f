"""TLS authorities for tests, and what openssl says of what they issue."""

import ipaddress
import subprocess
import time
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from rossec.console.tls.certificates import TlsAuthority, key_pem

NAME = "rossec.local"
HOST = ipaddress.IPv4Address("192.168.1.5")
NOW = int(time.time())


def new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def new_authority(name: str = NAME, address: ipaddress.IPv4Address | None = HOST) -> TlsAuthority:
    return TlsAuthority.create(new_key(), name, address, now=NOW, serial=7)


def foreign_leaf(
    authority: TlsAuthority,
    key: ec.EllipticCurvePrivateKey,
    names: list[x509.GeneralName],
    subject: x509.Name | None = None,
) -> bytes:
    """What a thief of the authority's key would sign (PEM): its usual leaf, with other names."""
    usual = x509.load_der_x509_certificate(authority.issue(key.public_key(), now=NOW, serial=9))
    builder = (
        x509.CertificateBuilder()
        .serial_number(usual.serial_number)
        .public_key(key.public_key())
        .subject_name(usual.subject if subject is None else subject)
        .issuer_name(usual.issuer)
        .not_valid_before(usual.not_valid_before_utc)
        .not_valid_after(usual.not_valid_after_utc)
    )
    for extension in usual.extensions:
        if not isinstance(extension.value, x509.SubjectAlternativeName):
            builder = builder.add_extension(extension.value, extension.critical)
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return builder.sign(authority.key, hashes.SHA256()).public_bytes(Encoding.PEM)


def pem(der: bytes) -> bytes:
    return x509.load_der_x509_certificate(der).public_bytes(Encoding.PEM)


def openssl_verify(directory: Path, authority: TlsAuthority, leaf: bytes, *options: str) -> str:
    """What `openssl verify -x509_strict` says of `leaf` (PEM); empty: it is valid."""
    root, file = directory / "root.pem", directory / "leaf.pem"
    root.write_bytes(pem(authority.data))
    file.write_bytes(leaf)
    done = subprocess.run(
        [
            "openssl",
            "verify",
            "-x509_strict",
            "-purpose",
            "sslserver",
            *options,
            "-CAfile",
            str(root),
            str(file),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    return "" if done.returncode == 0 else done.stderr


def bundle(authority: TlsAuthority, key: ec.EllipticCurvePrivateKey, leaf: bytes) -> bytes:
    return key_pem(key) + leaf
