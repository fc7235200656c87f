"""The authority: creates a trust domain's root, and issues certificates to its nodes.

It issues exactly what a request shows (name and key) and nothing the approver did not see; a
wildcard tail only if the approver asks for it. Time and randomness are arguments: `now`, and
serials of 128 random bits. Whether an identity may be issued is decided by the store and the
operator.
"""

from datetime import UTC, datetime
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from ca.certificates import Identity, TrustAnchor
from ca.errors import IssueRefused
from ca.intermediates import Intermediate, check_intermediate_request, policy
from ca.keys.publickey import require_p256, thumbprint
from ca.keys.signer import Signer
from ca.keys.x509signer import X509Signer
from ca.names import check_domain, check_wildcard, spiffe_id
from ca.renewal import BACKDATE, Renewal
from ca.requests import check_request
from ca.svid import SCHEME, WILDCARD, WILDCARD_VALUE

DAY: Final = 86_400
LIFETIME: Final = 30 * DAY
MAX_LIFETIME: Final = 366 * DAY
ROOT_LIFETIME: Final = 3650 * DAY
_SERIAL_LIMIT: Final = 1 << 128


class Authority:
    """A trust domain's root or intermediate, with the signer of its key.

    `anchor` is the root that nodes trust, `chain` follows each leaf (empty, or the intermediate).
    """

    def __init__(
        self, signer: Signer, certificate: bytes, intermediate: bytes | None = None
    ) -> None:
        """Combine the key with the root's certificate (DER), or with an intermediate's below it.

        Raises:
            CertificateRefused: not an authority's certificate.
            IssueRefused: it belongs to another key.
        """
        self.anchor = TrustAnchor.load(certificate)
        self.issuer: TrustAnchor | Intermediate = self.anchor
        self.chain: tuple[bytes, ...] = ()
        self.may_enroll = True
        if intermediate is not None:
            self._load_intermediate(intermediate)
        if thumbprint(signer.public_key) != self.issuer.thumbprint:
            raise IssueRefused(
                "the authority's certificate belongs to another key",
                "restore ca.key and ca.pem from the same backup",
            )
        self.signer = signer

    def _load_intermediate(self, der: bytes) -> None:
        # Its validity is checked at each use, by `_period`.
        found = self.anchor.read_intermediate(der)
        self.issuer, self.chain, self.may_enroll = found, (der,), found.may_enroll

    @property
    def is_root(self) -> bool:
        """Whether this is the trust domain's root, which alone can revoke."""
        return self.issuer is self.anchor

    def issue(
        self,
        csr: bytes,
        *,
        now: int,
        serial: int,
        lifetime: int = LIFETIME,
        wildcard: bool = False,
    ) -> bytes:
        """Return the certificate (DER) that `csr` requests, valid for `lifetime` seconds.

        It is backdated by an hour and ends with the authority's own certificate at the latest.
        `serial` is 128 random bits. With `wildcard` the identity also covers the names of
        anonymous nodes (`ca.names.covers`), whether the request asks for that or not.

        Raises:
            RequestRefused: the request is invalid.
            NameRefused: this name cannot have a wildcard tail.
            IssueRefused: serial or lifetime out of range, or the authority itself is not valid now.
        """
        if not self.may_enroll:
            raise IssueRefused(
                "this intermediate may renew identities, not enroll nodes",
                "enroll at the root, or make an intermediate that may enroll",
            )
        request = check_request(csr, self.anchor.domain, wildcard=wildcard)
        return self._issue(
            request.name, request.public_key, now, serial, lifetime, wildcard=wildcard
        )

    def renew(self, renewal: Renewal, *, now: int, serial: int, lifetime: int = LIFETIME) -> bytes:
        """Return the successor (DER) of an identity, with at most the same lifetime.

        Raises:
            IssueRefused: as `issue`, but an intermediate needs no permission to enroll.
        """
        key, longest = renewal.request.public_key, min(lifetime, renewal.max_lifetime)
        return self.reissue(renewal.identity, key, now=now, serial=serial, lifetime=longest)

    def reissue(
        self,
        identity: Identity,
        key: ec.EllipticCurvePublicKey,
        *,
        now: int,
        serial: int,
        lifetime: int = LIFETIME,
    ) -> bytes:
        """Return a successor (DER) of `identity` for `key`; the caller has authorized it.

        Raises:
            IssueRefused: as `issue`, but an intermediate needs no permission to enroll.
        """
        return self._issue(identity.name, key, now, serial, lifetime, wildcard=identity.wildcard)

    def issue_intermediate(
        self, csr: bytes, *, now: int, serial: int, may_enroll: bool, lifetime: int
    ) -> bytes:
        """Return the certificate (DER) of an intermediate; `may_enroll` sets its policy.

        Raises:
            RequestRefused: the request is invalid.
            IssueRefused: this is not a root, or its form has no intermediates, or as `issue`.
        """
        key = check_intermediate_request(csr, self.anchor.domain)
        if not self.is_root or self.anchor.path_length == 0:
            raise IssueRefused(
                "this authority may have no intermediates",
                "only a root can make one, and roots of older versions cannot",
            )
        _check_serial(serial)
        start, end = self._period(now, lifetime)
        builder = _authority(key, serial, start, end, self.anchor.domain, below=0)
        return _sign(
            builder.issuer_name(self.anchor.subject)
            .add_extension(policy(may_enroll=may_enroll), critical=False)
            .add_extension(_issuer_key(self.anchor.public_key), critical=False),
            self.signer,
        )

    def _issue(
        self,
        name: str,
        key: ec.EllipticCurvePublicKey,
        now: int,
        serial: int,
        lifetime: int,
        *,
        wildcard: bool,
    ) -> bytes:
        _check_serial(serial)
        start, end = self._period(now, lifetime)
        uri = spiffe_id(self.anchor.domain, name)
        builder = (
            _builder(key, serial, start, end)
            .subject_name(x509.Name([]))
            .issuer_name(self.issuer.subject)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(authority=False), critical=True)
            # Critical because the subject is empty (RFC 5280 section 4.1.2.6).
            .add_extension(_name(uri), critical=True)
            .add_extension(_issuer_key(self.issuer.public_key), critical=False)
        )
        if wildcard:
            check_wildcard(name)
            tail = x509.UnrecognizedExtension(WILDCARD, WILDCARD_VALUE)
            builder = builder.add_extension(tail, critical=False)
        return _sign(builder, self.signer)

    def _period(self, now: int, lifetime: int) -> tuple[int, int]:
        if not 0 < lifetime <= MAX_LIFETIME:
            raise IssueRefused(
                f"a lifetime of {lifetime} s where 1 to {MAX_LIFETIME} are allowed",
                "certificates are renewed instead: the default is 30 days",
            )
        first = max(self.issuer.not_before, self.anchor.not_before)
        last = min(self.issuer.not_after, self.anchor.not_after)
        if not first <= now <= last:
            raise IssueRefused(
                "the authority's own certificate is not valid now",
                "check this computer's clock; an expired authority must be replaced by a new one",
            )
        return max(now - BACKDATE, first), min(now + lifetime, last)


def create_root(signer: Signer, domain: str, *, now: int, serial: int) -> bytes:
    """Return a new root certificate (DER) for `domain`, valid for ten years.

    Raises:
        NameRefused: `domain` is not a trust domain.
        IssueRefused: the serial is out of range.
    """
    check_domain(domain)
    _check_serial(serial)
    key = require_p256(signer.public_key)
    builder = _authority(key, serial, now - BACKDATE, now + ROOT_LIFETIME, domain, below=1)
    return _sign(builder.issuer_name(_subject_name(key)), signer)


def _authority(
    key: ec.EllipticCurvePublicKey, serial: int, start: int, end: int, domain: str, *, below: int
) -> x509.CertificateBuilder:
    """The common part of a root and an intermediate."""
    return (
        _builder(key, serial, start, end)
        .subject_name(_subject_name(key))
        .add_extension(x509.BasicConstraints(ca=True, path_length=below), critical=True)
        .add_extension(_usage(authority=True), critical=True)
        .add_extension(_name(f"{SCHEME}{domain}"), critical=False)
        .add_extension(x509.SubjectKeyIdentifier(_key_identifier(key)), critical=False)
    )


def _subject_name(key: ec.EllipticCurvePublicKey) -> x509.Name:
    """A name that differs for every key, so that a foreign issuer is recognized by its name."""
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"rossec {_short(key)}")])


def _short(key: ec.EllipticCurvePublicKey) -> str:
    return thumbprint(key)[:8].hex()


def _key_identifier(key: ec.EllipticCurvePublicKey) -> bytes:
    """RFC 7093 allows any short digest of the key; ours is the start of its thumbprint."""
    return thumbprint(key)[:20]


def _issuer_key(key: ec.EllipticCurvePublicKey) -> x509.AuthorityKeyIdentifier:
    return x509.AuthorityKeyIdentifier(_key_identifier(key), None, None)


def _check_serial(serial: int) -> None:
    if not 0 < serial < _SERIAL_LIMIT:
        raise IssueRefused("a serial is a positive number of 128 bits", "use secrets.randbits(128)")


def _builder(
    key: ec.EllipticCurvePublicKey, serial: int, start: int, end: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .serial_number(serial)
        .public_key(key)
        .not_valid_before(datetime.fromtimestamp(start, UTC))
        .not_valid_after(datetime.fromtimestamp(end, UTC))
    )


def _sign(builder: x509.CertificateBuilder, signer: Signer) -> bytes:
    return builder.sign(X509Signer(signer), hashes.SHA256()).public_bytes(Encoding.DER)


def _name(uri: str) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri)])


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=authority,
        crl_sign=authority,
        encipher_only=False,
        decipher_only=False,
    )
