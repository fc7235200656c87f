"""The console's own TLS authority: its certificate, those it issues, and how a person compares it. Pure.

A browser that trusts it must be able to trust it with nothing else, so it is never the authority of the
robots. What a phone shows of a certificate is the SHA-256 of its DER form in hex: that is compared. The words
are its first 88 bits, for saying aloud (one person at the terminal, one at the phone).
"""

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from importlib import resources
from ipaddress import IPv4Address, IPv6Address, ip_network
from typing import Final, Self

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from ca.builder import common_name, tls_authority, tls_server
from ca.certificates import BACKDATE
from rossec import clock
from rossec.errors import ConfigurationError

DAY: Final = 86400
LIFETIME: Final = 365 * DAY
LEAF_LIFETIME: Final = 90 * DAY
SOON: Final = 30 * DAY  # seconds before its end in which a person is told
_PAIRS: Final = 16  # of the fingerprint in a line, as phones break it
# Eight words of the PGP list would be 64 bits, which somebody with much hardware could match; BIP-39's have
# 11 bits.
COUNT: Final = 8
_BITS: Final = 11
_MAX_COMMON_NAME: Final = 64  # RFC 5280 appendix A: ub-common-name
_EVERY: Final = (ip_network("0.0.0.0/0"), ip_network("::/0"))
_LEAF: Final = "rossec console"
_RENEW: Final = "make a new one: rossec console tls --renew"

Address = IPv4Address | IPv6Address


@dataclass(frozen=True)
class TlsAuthority:
    """The authority with its key; `name` and `address` are all that it can certify."""

    key: ec.EllipticCurvePrivateKey
    data: bytes  # its certificate in DER
    name: str
    address: Address | None
    not_before: int
    not_after: int

    @classmethod
    def create(
        cls, key: ec.EllipticCurvePrivateKey, name: str, address: Address | None, *, now: int, serial: int
    ) -> Self:
        """A new authority for `name`, a DNS name in lower case, valid for a year."""
        # For whoever gets the key: no other authority below it, TLS servers alone, one name and one address.
        period = now - BACKDATE, now + LIFETIME
        text, limits = f"rossec console {name}"[:_MAX_COMMON_NAME], _constraints(name, address)
        made = tls_authority(key, text, serial, period, limits)
        return cls.load(key, made.public_bytes(Encoding.DER))

    @classmethod
    def load(cls, key: ec.EllipticCurvePrivateKey, data: bytes) -> Self:
        try:
            certificate = x509.load_der_x509_certificate(data)
            found = certificate.extensions.get_extension_for_class(x509.NameConstraints).value
            permitted = found.permitted_subtrees or []
            (name,) = (each.value for each in permitted if isinstance(each, x509.DNSName))
        except (ValueError, x509.ExtensionNotFound) as error:
            raise ConfigurationError(
                "the certificate of the console's TLS authority is damaged", _RENEW
            ) from error
        if certificate.public_key() != key.public_key():
            raise ConfigurationError("the console's TLS authority has the certificate of another key", _RENEW)
        networks = [each.value for each in permitted if isinstance(each, x509.IPAddress)]
        address = getattr(networks[0], "network_address", None) if networks else None
        start, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
        return cls(key, data, name, address, int(start.timestamp()), int(end.timestamp()))

    def issue(
        self, key: ec.EllipticCurvePublicKey, *, now: int, serial: int, address: Address | None = None
    ) -> bytes:
        """A server's certificate (DER) for `name`, valid for 90 days, or until the authority ends.

        It also has the address of the authority if that is still `address`, this host's.
        """
        self.check_time(now)
        end = min(now + LEAF_LIFETIME, self.not_after)
        start = max(now - BACKDATE, self.not_before)
        names: list[x509.GeneralName] = [x509.DNSName(self.name)]
        if address is not None and address == self.address:
            names.append(x509.IPAddress(address))
        issuer = x509.load_der_x509_certificate(self.data).subject
        made = tls_server(self.key, issuer, key, _LEAF, names, serial, (start, end))
        return made.public_bytes(Encoding.DER)

    def check_time(self, now: int) -> None:
        if now > self.not_after:
            raise ConfigurationError("the console's TLS authority has expired", _RENEW)
        if now < self.not_before:
            raise ConfigurationError(
                "the console's TLS authority is not valid yet", "check this computer's clock"
            )


def _constraints(name: str, address: Address | None) -> x509.NameConstraints:
    # A name form without a permitted subtree would be unconstrained (RFC 5280 section 4.2.1.10): so each form
    # that verifiers know has one, and addresses, which have two sizes, are excluded besides.
    permitted: list[x509.GeneralName] = [
        x509.DNSName(name),
        x509.DirectoryName(common_name(_LEAF)),
        x509.RFC822Name(name),
        x509.UniformResourceIdentifier(name),
    ]
    excluded = [x509.IPAddress(network) for network in _EVERY]
    if address is not None:
        permitted.append(x509.IPAddress(ip_network(address)))
        excluded = [each for each in excluded if each.value.version != address.version]
    return x509.NameConstraints(permitted, excluded)


def in_hex(certificate: bytes) -> str:
    return sha256(certificate).digest().hex(":").upper()


def in_words(certificate: bytes) -> str:
    number = int.from_bytes(sha256(certificate).digest(), "big")
    return " ".join(word_list()[number >> 256 - _BITS * place & 0x7FF] for place in range(1, COUNT + 1))


@lru_cache(maxsize=1)
def word_list() -> tuple[str, ...]:
    text = (resources.files(__package__) / "words.txt").read_text("ascii")
    return tuple(line for line in text.splitlines() if not line.startswith("#"))


def describe(authority: TlsAuthority, now: int) -> list[str]:
    """Lines for a person at the terminal, who compares the fingerprint with the phone's."""
    pairs = in_hex(authority.data).split(":")
    lines = [":".join(pairs[start : start + _PAIRS]) for start in range(0, len(pairs), _PAIRS)]
    names = authority.name if authority.address is None else f"{authority.name} and {authority.address}"
    left, renew = authority.not_after - now, "rossec console tls --renew"
    warning = "" if left > SOON else f", in {left // DAY} days: {renew}"
    warning = warning if left > 0 else f": it has expired; {renew}"
    return [
        f"TLS authority of the console, for {names} alone",
        f"valid until {clock.format_time(authority.not_after)}{warning}",
        "SHA-256 fingerprint, to compare with what the phone shows of the certificate:",
        *(f"    {line}" for line in lines),
        "the same in words, to say aloud:",
        f"    {in_words(authority.data)}",
    ]


def as_json(authority: TlsAuthority) -> dict[str, object]:
    """As `describe`, for programs."""
    return {
        "name": authority.name,
        "address": None if authority.address is None else str(authority.address),
        "not_before": authority.not_before,
        "not_after": authority.not_after,
        "sha256": in_hex(authority.data),
        "words": in_words(authority.data),
    }
