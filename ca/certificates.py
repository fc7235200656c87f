"""Certificates: from untrusted bytes to the verified identity of a peer, or a refusal.

The form is the X.509-SVID of SPIFFE without its options (`ca.svid`), issued by the trust anchor or
by one intermediate. A valid identity requests its successor without operator action.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from ca import errors, svid
from ca.bounded import Newest
from ca.encoding import Value
from ca.keys.signing import Profile, PublicKey, Signer, thumbprint
from ca.names import SCHEME, check_domain, check_wildcard, covers, parse_spiffe_id, refuse_alias

SET_CLOCK: Final = "set this host's clock, or synchronize it (NTP)"
_SECONDS: Final = 180  # up to which a span is given in seconds
_DAY: Final = 86_400
_PLAUSIBLE: Final = 2 * _DAY  # that a host was off, or nothing was signed

# Private policies, from UUIDs (ITU-T X.667): what an intermediate's host may do, as its own tools
# (`ca.authority`) enforce. They do not bind an attacker: the holder of an intermediate's key can sign
# any name until the root revokes it.
MAY_RENEW: Final = x509.ObjectIdentifier("2.25.283421307419275216482910536471209357741")
MAY_ENROLL: Final = x509.ObjectIdentifier("2.25.140372948105529641730282947561038846219")
_HINT: Final = "make it on the host with `rossec ca intermediate request`"

_MAX_PEM: Final = 16 * 1024

CHAINS: Final = 256  # of one trust anchor that are known to be signed; each is 2 to 4 kB
_ROOTS: Final = 128  # more than a list of domains can have

PROFILE: Final = Profile("rossec-renewal+cwt")
MAX_CHAIN: Final = 2
MAX_RENEWAL: Final = svid.MAX_REQUEST + MAX_CHAIN * svid.MAX_CERTIFICATE + 512
MAX_AGE: Final = 300  # seconds: two clocks and a slow network
# Certificates are backdated by this much: the clock of robots without a battery-backed one may be
# behind after a start.
BACKDATE: Final = 3600
_IAT, _CSR, _CHAIN = 6, -70021, -70022


def utc(seconds: int) -> str:
    """Seconds since the epoch as `2026-11-20 18:00:00 UTC`; the number if out of range."""
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return f"second {seconds}"


def span(seconds: int) -> str:
    """A span in one unit: `59 s`, `7 min`, `5 h`, `400 days`."""
    if seconds < _SECONDS:
        return f"{seconds} s"
    for size, unit, least in ((_DAY, "days", 2 * _DAY), (3600, "h", 7200)):
        if seconds >= least:
            return f"{seconds // size} {unit}"
    return f"{seconds // 60} min"


def way_back(name: str) -> str:
    if name == "/ca":
        return "rossec ca renew /ca"
    return f"rossec ca renew --expired {name}, then on its machine: rossec node install FILE"


def check_time(what: str, start: int, end: int, now: int, back: str) -> None:
    # The moment is that of the host's clock, which may be wrong: so the hint has both cases. What is not
    # valid yet is always a matter of clocks, as all certificates begin an hour early.
    if now < start:
        raise errors.CertificateNotYetValid(
            f"the {what} becomes valid in {span(start - now)}",
            f"check this computer's clock: it says {utc(now)}",
        )
    if now > end:
        raise errors.CertificateExpired(
            f"the {what} expired {span(now - end)} ago, on {utc(end)}",
            f"this host's clock says {utc(now)}: if that is wrong, {SET_CLOCK}; else {back}",
        )


def own_end(name: str, end: int, now: int, seen: int) -> errors.CertificateExpired:
    """The refusal of this host's own identity `name`, which was valid until `end`."""
    # `seen` is the latest time that is known by anything else than the clock, such as the time of the newest
    # signature here. If it is after the end, or not long ago, the clock is not in doubt.
    back = f"where the authority is: {way_back(name)}"
    if seen >= end or now - seen <= _PLAUSIBLE:
        return errors.CertificateExpired(f"the identity of {name} ended on {utc(end)}", back)
    return errors.CertificateExpired(
        f"by this host's clock, which says {utc(now)}, the identity of {name} ended on {utc(end)};"
        f" nothing here is newer than {utc(seen)}",
        f"is the clock right? if not, {SET_CLOCK}; if it is, {back}",
    )


def everything_ended(domain: str, end: int, now: int) -> errors.CertificateExpired:
    return errors.CertificateExpired(
        f"by this host's clock, which says {utc(now)}, everything of {domain!r} is over, the"
        f" authority's own certificate too, since {utc(end)}",
        f"the clock is wrong, or the authority is ten years old: {SET_CLOCK}",
    )


@dataclass(frozen=True)
class Intermediate:
    """A verified intermediate. Times are inclusive, in seconds."""

    public_key: PublicKey
    thumbprint: bytes
    not_before: int
    not_after: int
    certificate: bytes
    subject: x509.Name
    serial: int
    may_enroll: bool


def read_intermediate(certificate: x509.Certificate, der: bytes, domain: str) -> Intermediate:
    """Read an intermediate whose signature was verified; its validity is not checked here."""
    # Its name is the domain. X.509 name constraints could say that of its leaves, but `cryptography`'s
    # verifier refuses chains that have them.
    extensions = svid.extensions(certificate)
    svid.check_intermediate(extensions)
    found = svid.trust_domain(extensions)
    if found != domain:
        raise errors.CertificateRefused(f"the intermediate is for trust domain {found!r}, not {domain!r}")
    key = svid.key_of(certificate)
    times = svid.validity(certificate)
    policies = svid.policies(extensions)
    if policies not in ({MAY_RENEW}, {MAY_ENROLL}):
        raise errors.CertificateRefused("the intermediate has no policy to renew or enroll", "make a new one")
    subject, serial = svid.subject(certificate), certificate.serial_number
    return Intermediate(key, thumbprint(key), *times, der, subject, serial, MAY_ENROLL in policies)


def policy(*, may_enroll: bool) -> x509.CertificatePolicies:
    power = MAY_ENROLL if may_enroll else MAY_RENEW
    return x509.CertificatePolicies([x509.PolicyInformation(power, None)])


def build_intermediate_request(signer: Signer, domain: str) -> bytes:
    builder = svid.request_builder(f"{SCHEME}{check_domain(domain)}")
    return svid.sign(builder, signer)


def check_intermediate_request(csr: bytes, domain: str) -> PublicKey:
    """Return the key of a request for an intermediate of `domain`; possession is proven."""
    key, *asked = svid.read_request(csr, _HINT)
    if asked != [f"{SCHEME}{domain}", False]:
        raise errors.RequestRefused(f"this is not a request for an intermediate of {domain!r}", _HINT)
    return key


@dataclass(frozen=True)
class Identity:
    """The identity in a verified certificate. Times are inclusive, in seconds.

    For a node of a foreign domain `name` is its alias here, `/remote/LABEL/...`, so that no
    comparison of names can take it for a node of the own domain (`ca.domains` sets that).
    """

    domain: str
    name: str  # which grants and rules are for
    public_key: PublicKey
    thumbprint: bytes  # of the key (RFC 9679)
    not_before: int
    not_after: int  # the earliest one of the chain below the anchor
    serial: int
    certificate: bytes  # DER, as received
    wildcard: bool = False  # it also covers anonymous nodes (`covers`)
    issuers: tuple[bytes, ...] = ()  # thumbprints of intermediates: when one is revoked, so is this identity
    certified: str = ""  # the name in a foreign node's certificate
    root: bytes = b""  # the thumbprint of the foreign root

    @property
    def certified_name(self) -> str:
        return self.certified or self.name

    @property
    def is_foreign(self) -> bool:
        return self.certified != ""

    def covers(self, name: str) -> bool:
        return covers(self.certified_name, name, wildcard=self.wildcard)

    def renews(self, other: "Identity") -> bool:
        """Whether it is `other` with a renewed certificate: nothing but times and issuer differ."""
        return all(
            getattr(self, each) == getattr(other, each)
            for each in ("domain", "name", "thumbprint", "wildcard", "certified", "root")
        )

    @property
    def keys(self) -> tuple[bytes, ...]:
        return (self.thumbprint, *self.issuers)


@dataclass(frozen=True)
class TrustAnchor:
    """The root certificate a node trusts. Create it with `load`: one root is one object, parsed once."""

    domain: str
    public_key: PublicKey
    thumbprint: bytes
    not_before: int
    not_after: int
    certificate: bytes
    subject: x509.Name
    path_length: int | None = 0
    # Of this root alone: what another domain's authority signs without end pushes out none of it.
    _verified: Newest[tuple[bytes, ...], tuple[Identity, Intermediate | None]] = field(
        default_factory=lambda: Newest(CHAINS), init=False, repr=False, compare=False
    )

    @classmethod
    def load(cls, der: bytes) -> "TrustAnchor":
        """Return the anchor in `der`, a self-signed root certificate. Its validity is not checked."""
        known = _loaded.use(der)
        if known is None:  # a sidecar has many nodes, and a new list of domains the same roots
            known = _loaded[der] = cls._read_root(der)
        return known

    @classmethod
    def _read_root(cls, der: bytes) -> "TrustAnchor":
        certificate = svid.parse(der)
        key, subject = svid.key_of(certificate), svid.subject(certificate)
        if not svid.is_signed_by(certificate, subject, key):
            raise errors.CertificateRefused(
                "the authority's certificate is not signed by itself",
                "take the ca.pem that `rossec ca init` wrote",
            )
        extensions = svid.extensions(certificate)
        svid.check_authority(extensions)
        domain, below = svid.trust_domain(extensions), svid.path_length(extensions)
        return cls(domain, key, thumbprint(key), *svid.validity(certificate), der, subject, below)

    def verify(self, chain: Sequence[bytes], now: int) -> Identity:
        """Return the identity of `chain`: a leaf, or a leaf and its intermediate, as DER."""
        # 1. Form and signatures. They are a function of the bytes and of this anchor alone, and peers connect
        #    again for every topic: what was found is kept, and only if all of it was right.
        certificates = tuple(chain)
        verified = self._verified.use(certificates)
        if verified is None:
            verified = self._verified[certificates] = self._read_chain(certificates)
        identity, intermediate = verified
        # 2. The times, at every use: of the issuers first, for whose end the remedy is another one.
        if intermediate is not None:
            _check_intermediate_time(intermediate, now)
        self.check_time(now)
        check_time(
            f"certificate of {identity.name}",
            identity.not_before,
            identity.not_after,
            now,
            f"where its authority is: {way_back(identity.name)}",
        )
        return identity

    def has_verified(self, chain: Sequence[bytes]) -> bool:
        """Whether form and signatures of `chain` are known to be right; nothing is said of its times."""
        return tuple(chain) in self._verified

    def _read_chain(self, chain: tuple[bytes, ...]) -> tuple[Identity, Intermediate | None]:
        # One or two certificates in this order. No path is built: there verifiers have most of their bugs.
        match chain:
            case (leaf,):
                return self._read_leaf(leaf, self), None
            case (leaf, second):
                issuer = self.read_intermediate(second)
                identity = self._read_leaf(leaf, issuer)
                # It ends with its intermediate, and is revoked with it.
                end = min(identity.not_after, issuer.not_after)
                return replace(identity, issuers=(issuer.thumbprint,), not_after=end), issuer
            case _:
                raise errors.CertificateRefused(
                    f"a chain of {len(chain)} certificates where one or two are expected",
                    "send the node's certificate and its intermediate's, if it has one",
                )

    def _read_leaf(self, der: bytes, issuer: "TrustAnchor | Intermediate") -> Identity:
        certificate = svid.parse(der)
        # The signature, before anything in the leaf is trusted.
        if not svid.is_signed_by(certificate, issuer.subject, issuer.public_key):
            raise self._foreign("certificate", certificate)
        return _read(self.domain, certificate, der)

    def read_intermediate(self, der: bytes) -> Intermediate:
        """Return the intermediate in `der`. Its validity is not checked here."""
        if self.path_length == 0:
            raise errors.CertificateRefused(
                "this authority may have no intermediates", "its root is of an older form"
            )
        certificate = svid.parse(der)
        if not svid.is_signed_by(certificate, self.subject, self.public_key):
            raise self._foreign("intermediate", certificate)
        return read_intermediate(certificate, der, self.domain)

    def check_intermediate(self, der: bytes, now: int) -> Intermediate:
        found = self.read_intermediate(der)
        _check_intermediate_time(found, now)
        return found

    def check_time(self, now: int) -> None:
        check_time(
            "authority's certificate",
            self.not_before,
            self.not_after,
            now,
            "the authority is ten years old, and must be replaced by a new one",
        )

    def _foreign(self, what: str, certificate: x509.Certificate) -> errors.ForeignCertificate:
        # What it claims to be is only said to a person: two sites of one name are a common mistake.
        text = f"the {what} is not signed by the authority of trust domain {self.domain!r}"
        hint = "enroll the node with this authority, or use the ca.pem that fits"
        try:
            claimed = svid.claimed_domain(certificate)
        except errors.CertificateRefused:
            claimed = ""
        if claimed == self.domain:
            return errors.ForeignCertificate(
                f"{text}, but has its name", f"is there another authority of that name? {hint}"
            )
        return errors.ForeignCertificate(f"{text}, but names {claimed!r}" if claimed else text, hint)


_loaded: Final[Newest[bytes, TrustAnchor]] = Newest(_ROOTS)


def _check_intermediate_time(found: Intermediate, now: int) -> None:
    check_time(
        "intermediate's certificate",
        found.not_before,
        found.not_after,
        now,
        "at the root: rossec ca intermediate sign FILE --may renew",
    )


def _read(domain: str, certificate: x509.Certificate, der: bytes) -> Identity:
    extensions = svid.extensions(certificate)
    svid.check_leaf(extensions)
    wildcard = svid.has_wildcard(extensions)
    try:
        found, name = parse_spiffe_id(svid.only_uri(extensions))
        refuse_alias(name)
        if wildcard:
            check_wildcard(name)
    except errors.NameRefused as error:
        raise errors.CertificateRefused(f"the certificate's name is invalid: {error}") from error
    if found != domain:
        raise errors.CertificateRefused(f"the certificate is for trust domain {found!r}, not {domain!r}")
    key = svid.key_of(certificate)
    start, end = svid.validity(certificate)
    serial = certificate.serial_number
    return Identity(domain, name, key, thumbprint(key), start, end, serial, der, wildcard)


def to_pem(*certificates: bytes) -> bytes:
    return b"".join(svid.parse(der).public_bytes(Encoding.PEM) for der in certificates)


def from_pem(data: bytes) -> tuple[bytes, ...]:
    if len(data) > _MAX_PEM:
        raise errors.CertificateRefused(
            f"{len(data)} bytes of PEM where at most {_MAX_PEM} are allowed",
            "name the file with the node's certificate",
        )
    try:
        certificates = x509.load_pem_x509_certificates(data)
    except svid.PARSE_ERRORS as error:
        raise errors.CertificateRefused(
            "this is not a PEM certificate", "name the file that `rossec ca sign` wrote"
        ) from error
    return tuple(certificate.public_bytes(Encoding.DER) for certificate in certificates)


@dataclass(frozen=True)
class Renewal:
    identity: Identity
    request: svid.IdentityRequest
    csr: bytes

    @property
    def max_lifetime(self) -> int:
        """The lifetime (seconds) of the identity, which the successor's may not exceed."""
        return self.identity.not_after - signed_at(self.identity.not_before, self.identity.not_after)


def signed_at(not_before: int, not_after: int) -> int:
    """When an identity was signed: the backdated hour is not part of its lifetime."""
    # Otherwise each successor would live an hour longer, and a short one would be due at once.
    began = not_before + BACKDATE
    return began if began < not_after else not_before


def renew_at(not_before: int, not_after: int) -> int:
    """When to renew: after two thirds of an identity's lifetime."""
    began = signed_at(not_before, not_after)
    return began + (not_after - began) * 2 // 3


def retry_delay(not_before: int, not_after: int, longest: int) -> int:
    """Seconds to wait after a refusal, at most `longest`; a twentieth of a short lifetime."""
    life = not_after - signed_at(not_before, not_after)
    return max(1, min(longest, life // 20))


def sign_renewal(old: Signer, chain: Sequence[bytes], csr: bytes, now: int) -> bytes:
    """Sign, with the old key, the request that `csr` succeed `chain` (DER, leaf first)."""
    # A node writes its new key to the disk *before* it sends this, and repeats the same bytes until it has
    # the answer: the authority answers one request always with the same certificate.
    certificates: list[Value] = [*chain]
    return PROFILE.sign(old, {_IAT: now, _CSR: csr, _CHAIN: certificates})


def open_renewal(data: bytes, anchor: TrustAnchor, now: int, check: Callable[[bytes, int], None]) -> Renewal:
    """Return the renewal in `data`, if it is valid."""
    # `check(entry, now)` raises when a key's thumbprint is revoked, or its status is unknown
    # (`Revocations.check`).
    # 1. The chain in it says whose signature to verify; nothing else of it is used before that.
    try:
        _, _, chain = _read_renewal(PROFILE.peek(data, limit=MAX_RENEWAL))
    except (errors.SignatureError, errors.EncodingError) as error:
        raise errors.CAError(f"this is not a renewal: {error}") from error
    identity = anchor.verify(chain, now)
    try:
        issued, csr, _ = _read_renewal(PROFILE.open(data, identity.public_key, limit=MAX_RENEWAL))
    except (errors.SignatureError, errors.EncodingError) as error:
        raise errors.CAError(
            f"the renewal is not signed by {identity.name}: {error}", "renew on the node that has the key"
        ) from error
    # 2. The old identity counts, now, and asks for its own name. The CSR proves possession of the new key,
    # the old key's signature around it the right to the name.
    for key in identity.keys:
        check(key, now)
    if not now - MAX_AGE <= issued <= now + MAX_AGE:
        raise errors.CAError("the renewal is too old, or from the future", "check both clocks")
    request = svid.check_request(csr, anchor.domain, wildcard=identity.wildcard)
    if request.name != identity.name:
        raise errors.CAError(
            f"{identity.name} requests the identity of {request.name}",
            "a node renews its own name; for another one it must be enrolled",
        )
    # 3. At least half of its lifetime is over: a node in a loop does not fill the record.
    began = signed_at(identity.not_before, identity.not_after)
    half = began + (identity.not_after - began) // 2
    if now < half:
        raise errors.CAError(
            f"the identity of {identity.name} is not due for renewal for {half - now} s",
            "possible after half its lifetime; before that, where the authority is:"
            f" rossec ca renew {identity.name}",
        )
    return Renewal(identity, request, csr)


def _read_renewal(value: Value) -> tuple[int, bytes, tuple[bytes, ...]]:
    match value:
        case {6: int() as issued, -70021: bytes() as csr, -70022: list() as items, **rest} if (
            not rest and not isinstance(issued, bool) and 1 <= len(items) <= MAX_CHAIN
        ):
            chain = tuple(item for item in items if isinstance(item, bytes))
        case _:
            raise errors.CAError("the renewal has missing or unknown fields")
    if len(chain) != len(items):
        raise errors.CAError("the renewal's chain is not a list of certificates")
    return issued, csr, chain
