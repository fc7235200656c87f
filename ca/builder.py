"""The one place where X.509 certificates are built, of identities and of servers of TLS. Pure.

Who may have one, for how long and in which form is said by those who call this: `ca.authority` for
identities, the console and the routers for their own authorities of TLS, which nothing else trusts.
"""

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

# In the authority's certificate too: verifiers that nest usages, as browsers do, take nothing else below it.
_SERVER: Final = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])


def begin(
    key: ec.EllipticCurvePublicKey,
    subject: x509.Name,
    issuer: x509.Name,
    serial: int,
    period: tuple[int, int],
    *,
    below: int | None = None,
) -> x509.CertificateBuilder:
    """What every certificate has. `below`: how many authorities may follow this one; None: it is none."""
    is_authority = below is not None
    usage = x509.KeyUsage(
        digital_signature=not is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        encipher_only=False,
        decipher_only=False,
    )
    start, end = period
    return (
        x509.CertificateBuilder()
        .serial_number(serial)
        .public_key(key)
        .subject_name(subject)
        .issuer_name(issuer)
        .not_valid_before(datetime.fromtimestamp(start, UTC))
        .not_valid_after(datetime.fromtimestamp(end, UTC))
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=below), critical=True)
        .add_extension(usage, critical=True)
    )


def common_name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def tls_authority(
    key: ec.EllipticCurvePrivateKey,
    name: str,
    serial: int,
    period: tuple[int, int],
    constraints: x509.NameConstraints | None = None,
) -> x509.Certificate:
    """An authority that signs itself, for TLS servers alone and for no other authority (path length 0)."""
    public, subject = key.public_key(), common_name(name)
    builder = begin(public, subject, subject, serial, period, below=0)
    if constraints is not None:
        builder = builder.add_extension(constraints, critical=True)
    builder = builder.add_extension(_SERVER, critical=False)
    identifier = x509.SubjectKeyIdentifier.from_public_key(public)
    return builder.add_extension(identifier, critical=False).sign(key, hashes.SHA256())


def tls_server(
    authority: ec.EllipticCurvePrivateKey,
    issuer: x509.Name,
    key: ec.EllipticCurvePublicKey,
    name: str,
    names: Iterable[x509.GeneralName],
    serial: int,
    period: tuple[int, int],
) -> x509.Certificate:
    """A server's certificate by an authority of TLS; `names`: by which browsers and peers reach it."""
    identifier = x509.SubjectKeyIdentifier.from_public_key(authority.public_key()).digest
    return (
        begin(key, common_name(name), issuer, serial, period)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(_SERVER, critical=False)
        .add_extension(x509.AuthorityKeyIdentifier(identifier, None, None), critical=False)
        .sign(authority, hashes.SHA256())
    )
