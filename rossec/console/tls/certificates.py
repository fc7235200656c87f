"""The console's certificates: of the TLS authority on disk, or the operator's files, kept new. A shell.

A source gives bundles: the private key and the chain, both PEM. It is asked again every minute; a bundle is
given when it is a new one, so the server goes on without a restart. What cannot be used is refused at the
start; later the bundle of before stays, and the log says why.
"""

import asyncio
import logging
import os
import secrets
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from importlib import resources
from ipaddress import IPv4Address, IPv6Address, ip_address, ip_network
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol, Self

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from ca.builder import common_name, tls_authority, tls_server
from ca.certificates import BACKDATE
from rossec import clock, files
from rossec.authority.console import messages
from rossec.console.options import ConsoleEndpoint, Tls
from rossec.errors import ConfigurationError
from rossec.host import addresses

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
    # A browser that trusts it must be able to trust it with nothing else, so it is never the authority of the
    # robots. A phone shows the SHA-256 of its DER form in hex: that is compared. The words are its first 88
    # bits, for saying aloud (one person at the terminal, one at the phone).
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


DIRECTORY: Final = messages.DIRECTORY
KEY, CERTIFICATE = messages.TLS_KEY, messages.TLS_CERTIFICATE
PERIOD: Final = 60.0  # seconds between two looks
_MAX_FILE: Final = 8 * 1024
_MAX_CHAIN: Final = 64 * 1024
_NONE: Final = ConfigurationError(
    "the console has no TLS authority", "make one: rossec console tls --renew, or --lan"
)
_log = logging.getLogger("rossec.console")


def open_authority(directory: Path) -> TlsAuthority:
    """The authority in `directory`. Its validity is not checked here."""
    pem = files.read_own(directory / KEY, _MAX_FILE, _NONE)
    if os.lstat(directory / KEY).st_mode & 0o077:
        raise ConfigurationError(f"{directory / KEY} can be read by others", _RENEW)
    try:
        key = load_pem_private_key(pem, None)
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{KEY} is damaged", _RENEW) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.curve.name != "secp256r1":
        raise ConfigurationError(f"{KEY} is not a P-256 key", _RENEW)
    pem = files.read_own(directory / CERTIFICATE, _MAX_FILE, _NONE)
    try:
        data = x509.load_pem_x509_certificate(pem).public_bytes(Encoding.DER)
    except ValueError as error:
        raise ConfigurationError(f"{CERTIFICATE} is damaged", _RENEW) from error
    # That the two belong together is checked there: a crash between their renewals leaves them apart.
    return TlsAuthority.load(key, data)


def exists(directory: Path) -> bool:
    return (directory / KEY).exists() or (directory / CERTIFICATE).exists()


def renew(directory: Path, name: str, host: Address | None, now: int) -> TlsAuthority:
    files.make_private_directory(directory)
    with files.locked_directory(directory):
        key = ec.generate_private_key(ec.SECP256R1())
        made = TlsAuthority.create(key, name, host, now=now, serial=random_serial())
        # 0600 and O_EXCL. It is left out of backups: who restores the authority of the robots makes a new one
        # for browsers.
        fresh = directory / f"{KEY}.{secrets.token_hex(8)}"
        files.create(fresh, key_pem(key))
        fresh.replace(directory / KEY)
        pem = x509.load_der_x509_certificate(made.data).public_bytes(Encoding.PEM)
        files.replace(directory / CERTIFICATE, pem, 0o644)
    return made


def authority_for(
    directory: Path, name: str, host: Address | None, now: int, *, rename: bool
) -> TlsAuthority:
    if not exists(directory):
        return renew(directory, name, host, now)
    found = open_authority(directory)
    if found.name != name:
        if rename:
            return renew(directory, name, host, now)
        raise ConfigurationError(
            f"phones trust this console as {found.name}, not as {name}",
            f"start it with --name {found.name}; or add --rename, and set up every phone anew",
        )
    found.check_time(now)
    return found


def first_address() -> Address | None:
    found = map(ip_address, addresses.own_addresses())
    return next((each for each in found if not each.is_loopback and not each.is_link_local), None)


def random_serial() -> int:
    """127 random bits, not 0 (RFC 5280 section 4.1.2.2)."""
    return secrets.randbits(127) + 1


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


class CertificateSource(Protocol):
    def first(self, now: int) -> bytes: ...

    def newer(self, now: int) -> bytes | None: ...


class OwnCertificates:
    """Issued by the console's own authority, each with a new key, which is in memory alone."""

    def __init__(self, authority: TlsAuthority, address: Address | None, serial: Callable[[], int]) -> None:
        self._authority, self._address, self._serial = authority, address, serial
        self._renew_at = 0

    def first(self, now: int) -> bytes:
        key = ec.generate_private_key(ec.SECP256R1())
        leaf = self._authority.issue(key.public_key(), now=now, serial=self._serial(), address=self._address)
        certificate = x509.load_der_x509_certificate(leaf)
        self._renew_at = renewal_time(now, _end(certificate))
        return key_pem(key) + certificate.public_bytes(Encoding.PEM)

    def newer(self, now: int) -> bytes | None:
        if now < self._renew_at:
            return None
        try:
            return self.first(now)
        except ConfigurationError as error:
            _log.error("%s; %s", error, error.hint)
            self._renew_at = now + 3600  # to be said again
            return None


class FileCertificates:
    """The operator's files, read again when they change, as a program that renews them does."""

    def __init__(self, certificate: Path, key: Path, name: str) -> None:
        self._paths = certificate, key
        self._name = name
        self._state: object = None

    def first(self, now: int) -> bytes:
        self._state = self._look()
        missing = (ConfigurationError(f"there is no {path}", "name a PEM file") for path in self._paths)
        chain, key = (
            files.read_own(path, _MAX_CHAIN, error, link=True)
            for path, error in zip(self._paths, missing, strict=True)
        )
        check_bundle(chain, key, self._name, now)
        return key.rstrip() + b"\n" + chain

    def newer(self, now: int) -> bytes | None:
        if self._look() == self._state:
            return None
        try:
            return self.first(now)
        except (ConfigurationError, OSError) as error:
            _log.error("the renewed certificate is not used: %s", error)
            return None

    def _look(self) -> object:
        try:
            status = [path.stat() for path in self._paths]
        except OSError:
            return None
        return [(each.st_ino, each.st_mtime_ns, each.st_size) for each in status]


def renewal_time(issued: int, end: int) -> int:
    # Two thirds: a third is left to be told of failures, which are tried again every hour.
    return issued + 2 * (end - issued) // 3


def check_bundle(chain: bytes, key: bytes, name: str, now: int) -> None:
    try:
        leaf = x509.load_pem_x509_certificates(chain)[0]
    except ValueError as error:
        raise ConfigurationError("--tls-cert has no PEM certificate", "name the chain") from error
    try:
        own = load_pem_private_key(key, None)
    except (ValueError, TypeError) as error:
        hint = "name a PEM file that has no passphrase"
        raise ConfigurationError("--tls-key has no private key", hint) from error
    form = Encoding.DER, PublicFormat.SubjectPublicKeyInfo
    if own.public_key().public_bytes(*form) != leaf.public_key().public_bytes(*form):
        hint = "the server's own certificate comes first"
        raise ConfigurationError("--tls-key is not the key of --tls-cert", hint)
    if now > _end(leaf):
        raise ConfigurationError("the certificate of --tls-cert has expired", "renew it")
    names = set[str]()
    with suppress(x509.ExtensionNotFound):
        found = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        names = {each.lower() for each in found.get_values_for_type(x509.DNSName)}
    # Its name, or a wildcard for its first label (RFC 9525 section 6.3).
    if names.isdisjoint({name, f"*.{name.partition('.')[2]}"}):
        said = f"the certificate of --tls-cert is not for {name}"
        raise ConfigurationError(said, "give its name with --name")


def _end(certificate: x509.Certificate) -> int:
    return int(certificate.not_valid_after_utc.timestamp())


class TlsSetup(NamedTuple):
    """Where the certificates come from, and the authority that issues them if it is the console's own."""

    source: CertificateSource
    authority: TlsAuthority | None = None


def prepare_tls(endpoint: ConsoleEndpoint, directory: Path, now: int, *, rename: bool) -> TlsSetup | None:
    """The certificates of `endpoint`; None: it does without."""
    # An authority for another name is replaced only with `rename`: every phone trusts the old one.
    if endpoint.tls is Tls.NONE:
        return None
    if endpoint.tls is Tls.OWN:
        host = first_address()
        authority = authority_for(directory, endpoint.name, host, now, rename=rename)
        return TlsSetup(OwnCertificates(authority, host, random_serial), authority)
    if endpoint.tls_certificate is None or endpoint.tls_key is None:
        raise ConfigurationError("a certificate needs its key", "give --tls-cert and --tls-key")
    source = FileCertificates(endpoint.tls_certificate, endpoint.tls_key, endpoint.name)
    source.first(now)
    return TlsSetup(source)


Install = Callable[[bytes], Awaitable[None]]


def renewed_from(
    source: CertificateSource, now: Callable[[], int], period: float = PERIOD
) -> Callable[[Install], Coroutine[Any, Any, None]]:
    """A function that installs the first bundle of `source`, then every newer one, for ever."""

    # It may be run again: a server that was started anew begins with a first bundle.
    async def install_all(install: Install) -> None:
        bundle: bytes | None = await asyncio.to_thread(source.first, now())
        while True:
            if bundle is not None:
                await install(bundle)
            await asyncio.sleep(period)
            bundle = await asyncio.to_thread(source.newer, now())

    return install_all
