"""A trust domain in memory, and certificates with one chosen flaw."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from ca.authority import Authority, create_root
from ca.certificates import TrustAnchor
from ca.keys.signing import KeySigner
from ca.svid import build_request

NOW = 1_800_000_000
DAY = 86_400
Extensions = Sequence[tuple[x509.ExtensionType, bool]]
PublicKey = ec.EllipticCurvePublicKey | ed25519.Ed25519PublicKey


def new_signer() -> KeySigner:
    return KeySigner(ec.generate_private_key(ec.SECP256R1()))


@dataclass(frozen=True)
class Site:
    """An authority and its anchor."""

    key: ec.EllipticCurvePrivateKey
    root: bytes
    authority: Authority
    anchor: TrustAnchor

    @classmethod
    def create(cls, domain: str = "home", now: int = NOW) -> "Site":
        key = ec.generate_private_key(ec.SECP256R1())
        signer = KeySigner(key)
        root = create_root(signer, domain, now=now, serial=1)
        return cls(key, root, Authority(signer, root), TrustAnchor.load(root))

    def leaf(self, name: str = "/robot1/camera", now: int = NOW, serial: int = 2) -> bytes:
        csr = build_request(new_signer(), self.anchor.domain, name)
        return self.authority.issue(csr, now=now, serial=serial)


def usage(*wanted: str) -> x509.KeyUsage:
    names = (
        "digital_signature",
        "content_commitment",
        "key_encipherment",
        "data_encipherment",
        "key_agreement",
        "key_cert_sign",
        "crl_sign",
        "encipher_only",
        "decipher_only",
    )
    return x509.KeyUsage(**{name: name in wanted for name in names})


def uris(*values: str) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([x509.UniformResourceIdentifier(v) for v in values])


def leaf_extensions(uri: str = "spiffe://home/robot1/camera") -> list[tuple[x509.ExtensionType, bool]]:
    return [
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (usage("digital_signature"), True),
        (uris(uri), True),
    ]


def root_extensions(uri: str = "spiffe://home") -> list[tuple[x509.ExtensionType, bool]]:
    return [
        (x509.BasicConstraints(ca=True, path_length=0), True),
        (usage("key_cert_sign"), True),
        (uris(uri), False),
    ]


@dataclass(frozen=True)
class Draft:
    """A certificate to be built, valid in every field not replaced."""

    issuer: x509.Name
    key: ec.EllipticCurvePrivateKey
    extensions: Extensions
    subject: x509.Name = dataclasses.field(default_factory=lambda: x509.Name([]))
    public_key: PublicKey | None = None
    start: int = NOW
    end: int = NOW + DAY
    algorithm: hashes.SHA256 | hashes.SHA384 = dataclasses.field(default_factory=hashes.SHA256)

    def build(self) -> bytes:
        builder = (
            x509.CertificateBuilder()
            .serial_number(7)
            .issuer_name(self.issuer)
            .subject_name(self.subject)
            .public_key(self.public_key or self.key.public_key())
            .not_valid_before(datetime.fromtimestamp(self.start, UTC))
            .not_valid_after(datetime.fromtimestamp(self.end, UTC))
        )
        for extension, critical in self.extensions:
            builder = builder.add_extension(extension, critical=critical)
        return builder.sign(self.key, self.algorithm).public_bytes(Encoding.DER)


def draft_leaf(site: Site, extensions: Extensions | None = None) -> Draft:
    wanted = leaf_extensions() if extensions is None else extensions
    public = ec.generate_private_key(ec.SECP256R1()).public_key()
    return Draft(site.anchor.subject, site.key, wanted, public_key=public)


def draft_root(extensions: Extensions | None = None) -> Draft:
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "test root")])
    key = ec.generate_private_key(ec.SECP256R1())
    return Draft(name, key, root_extensions() if extensions is None else extensions, subject=name)
