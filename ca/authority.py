"""The authority: creates a trust domain's root, and issues certificates to its nodes.

It issues exactly what a request shows (name and key) and nothing the approver did not see. Time and
randomness are arguments. What a signer is given is read before the key signs it (`read_unsigned`).
"""

from typing import Final, NamedTuple

from cryptography import x509

from ca import certificates, svid
from ca.builder import begin, common_name
from ca.errors import CAError, CertificateRefused, NameRefused
from ca.keys.passphrases import SEQUENCE, der
from ca.keys.signing import PublicKey, Signer, require_p256, thumbprint
from ca.names import SCHEME, check_domain, check_wildcard, parse_spiffe_id, spiffe_id

DAY: Final = 86_400
LIFETIME: Final = 30 * DAY
MAX_LIFETIME: Final = 366 * DAY
ROOT_LIFETIME: Final = 3650 * DAY
_SERIAL_LIMIT: Final = 1 << 128  # RFC 5280 section 4.1.2.2 allows 20 octets; 16 random ones never collide

# AlgorithmIdentifier: ecdsa-with-SHA256, without parameters (RFC 5758 section 3.2).
_ECDSA_WITH_SHA256: Final = bytes.fromhex("300a06082a8648ce3d040302")
# A BIT STRING of no unused bits with an ECDSA-Sig-Value of r = s = 1: nothing verifies it.
_NO_SIGNATURE: Final = bytes.fromhex("0309003006020101020101")


class Authority:
    """A trust domain's root or intermediate, with the signer of its key.

    `anchor` is the root that nodes trust, `chain` follows each leaf (empty, or the intermediate).
    """

    def __init__(self, signer: Signer, certificate: bytes, intermediate: bytes | None = None) -> None:
        self.anchor = certificates.TrustAnchor.load(certificate)
        self.issuer: certificates.TrustAnchor | certificates.Intermediate = self.anchor
        self.chain: tuple[bytes, ...] = ()
        self.may_enroll = True
        if intermediate is not None:
            # Its validity is checked at each use, by `_period`.
            found = self.anchor.read_intermediate(intermediate)
            self.issuer, self.chain, self.may_enroll = found, (intermediate,), found.may_enroll
        if thumbprint(signer.public_key) != self.issuer.thumbprint:
            raise CAError(
                "the authority's certificate belongs to another key",
                "restore ca.key and ca.pem from the same backup",
            )
        self.signer = signer

    @property
    def is_root(self) -> bool:
        return self.issuer is self.anchor

    def issue(
        self, csr: bytes, *, now: int, serial: int, lifetime: int = LIFETIME, wildcard: bool = False
    ) -> bytes:
        """Return the certificate (DER) that `csr` requests, valid for `lifetime` seconds."""
        # It is backdated by an hour and ends with the authority's own certificate at the latest. `serial` is
        # 128 random bits. With `wildcard` the identity also covers the names of anonymous nodes
        # (`ca.names.covers`), whether the request asks for that or not.
        if not self.may_enroll:
            raise CAError(
                "this intermediate may renew identities, not enroll nodes",
                "enroll at the root, or make an intermediate that may enroll",
            )
        # A wildcard tail is the approver's word: one that only the request asks for is refused.
        request = svid.check_request(csr, self.anchor.domain, wildcard=wildcard)
        return self._issue(request.name, request.public_key, now, serial, lifetime, wildcard=wildcard)

    def renew(
        self, renewal: certificates.Renewal, *, now: int, serial: int, lifetime: int = LIFETIME
    ) -> bytes:
        # Never longer than before: who once got a day does not make a year of it by renewals.
        key, longest = renewal.request.public_key, min(lifetime, renewal.max_lifetime)
        return self.reissue(renewal.identity, key, now=now, serial=serial, lifetime=longest)

    def reissue(
        self,
        identity: certificates.Identity,
        key: PublicKey,
        *,
        now: int,
        serial: int,
        lifetime: int = LIFETIME,
    ) -> bytes:
        return self._issue(identity.name, key, now, serial, lifetime, wildcard=identity.wildcard)

    def issue_intermediate(
        self, csr: bytes, *, now: int, serial: int, may_enroll: bool, lifetime: int
    ) -> bytes:
        key = certificates.check_intermediate_request(csr, self.anchor.domain)
        # An intermediate has path length 0: what it signed as an authority, no node would take.
        if not self.is_root or self.anchor.path_length == 0:
            raise CAError(
                "this authority may have no intermediates",
                "only a root can make one, and roots of older versions cannot",
            )
        _check_serial(serial)
        period, issuer = self._period(now, lifetime), self.anchor
        builder = _authority(key, issuer.subject, serial, period, issuer.domain, below=0)
        return svid.sign(
            builder.add_extension(certificates.policy(may_enroll=may_enroll), critical=False).add_extension(
                _issuer_key(issuer.public_key), critical=False
            ),
            self.signer,
        )

    def _issue(
        self, name: str, key: PublicKey, now: int, serial: int, lifetime: int, *, wildcard: bool
    ) -> bytes:
        _check_serial(serial)
        uri = svid.alternative_name(spiffe_id(self.anchor.domain, name))
        period = self._period(now, lifetime)
        builder = (
            begin(key, x509.Name([]), self.issuer.subject, serial, period)
            # Critical because the subject is empty (RFC 5280 section 4.1.2.6).
            .add_extension(uri, critical=True)
            .add_extension(_issuer_key(self.issuer.public_key), critical=False)
        )
        if wildcard:
            check_wildcard(name)
            builder = builder.add_extension(
                x509.UnrecognizedExtension(svid.WILDCARD, svid.WILDCARD_VALUE), critical=False
            )
        return svid.sign(builder, self.signer)

    def _period(self, now: int, lifetime: int) -> tuple[int, int]:
        if not 0 < lifetime <= MAX_LIFETIME:
            raise CAError(
                f"a lifetime of {lifetime} s where 1 to {MAX_LIFETIME} are allowed",
                "certificates are renewed instead: the default is 30 days",
            )
        first = max(self.issuer.not_before, self.anchor.not_before)
        last = min(self.issuer.not_after, self.anchor.not_after)
        if not first <= now <= last:
            raise CAError(
                "the authority's own certificate is not valid now",
                "check this computer's clock; an expired authority must be replaced by a new one",
            )
        return max(now - certificates.BACKDATE, first), min(now + lifetime, last)


def create_root(signer: Signer, domain: str, *, now: int, serial: int) -> bytes:
    check_domain(domain)
    _check_serial(serial)
    key = require_p256(signer.public_key)
    period = now - certificates.BACKDATE, now + ROOT_LIFETIME
    return svid.sign(_authority(key, _subject_name(key), serial, period, domain, below=1), signer)


def _authority(
    key: PublicKey, issuer: x509.Name, serial: int, period: tuple[int, int], domain: str, *, below: int
) -> x509.CertificateBuilder:
    return (
        begin(key, _subject_name(key), issuer, serial, period, below=below)
        .add_extension(svid.alternative_name(f"{SCHEME}{domain}"), critical=False)
        .add_extension(x509.SubjectKeyIdentifier(_key_identifier(key)), critical=False)
    )


def _subject_name(key: PublicKey) -> x509.Name:
    # A name that differs for every key, so that a foreign issuer is recognized by its name.
    return common_name(f"rossec {thumbprint(key)[:8].hex()}")


def _key_identifier(key: PublicKey) -> bytes:
    # RFC 7093 allows any short digest of the key; ours is the start of its thumbprint.
    return thumbprint(key)[:20]


def _issuer_key(key: PublicKey) -> x509.AuthorityKeyIdentifier:
    return x509.AuthorityKeyIdentifier(_key_identifier(key), None, None)


def _check_serial(serial: int) -> None:
    if not 0 < serial < _SERIAL_LIMIT:
        raise CAError("a serial is a positive number of 128 bits", "use secrets.randbits(128)")


class UnsignedCertificate(NamedTuple):
    name: str
    is_intermediate: bool


def read_unsigned(content: bytes, issuer: x509.Name, domain: str) -> UnsignedCertificate:
    """Read a TBSCertificate (DER) that `issuer`, an authority of `domain`, is to sign."""
    # Of a TBSCertificate (RFC 5280 section 4.1) only the two forms that an authority issues are accepted: the
    # process that holds the key does not sign whatever the process before it, which talks to strangers, says.
    # Completed with an empty signature, it is parsed as every certificate is.
    certificate = svid.parse(der(SEQUENCE, content, _ECDSA_WITH_SHA256, _NO_SIGNATURE))
    found = svid.certificate_signature(certificate, issuer)
    # Parsers may skip what they do not know: these are the very bytes that will be signed.
    if found is None or found.content != content:
        raise CertificateRefused("a certificate of another issuer, algorithm or form")
    svid.key_of(certificate)
    svid.validity(certificate)
    extensions = svid.extensions(certificate)
    if svid.is_authority(extensions):
        svid.check_intermediate(extensions)
        if svid.trust_domain(extensions) != domain:
            raise CertificateRefused("an intermediate of another trust domain")
        return UnsignedCertificate(domain, is_intermediate=True)
    svid.check_leaf(extensions)
    svid.has_wildcard(extensions)
    try:
        of_domain, name = parse_spiffe_id(svid.only_uri(extensions))
    except NameRefused as error:
        raise CertificateRefused(f"a certificate whose name is invalid: {error}") from error
    if of_domain != domain:
        raise CertificateRefused("an identity of another trust domain")
    return UnsignedCertificate(name, is_intermediate=False)
