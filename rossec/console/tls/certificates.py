"""Certificates for the console's server: whose turn it is to be replaced, and by what.

A source gives bundles: the private key and the chain, both PEM. It is asked again every minute; a
bundle is given when it is a new one, so the server goes on without a restart. What cannot be used
is refused at the start; later the bundle of before stays, and the log says why.
"""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
)

from rossec import files
from rossec.console.tls.authority import Address, TlsAuthority
from rossec.console.tls.store import key_pem
from rossec.errors import ConfigurationError

PERIOD: Final = 60.0  # seconds between two looks
_MAX_FILE: Final = 64 * 1024
_log = logging.getLogger("rossec.console")


class CertificateSource(Protocol):
    """Where the server's key and chain come from."""

    def first(self, now: int) -> bytes:
        """The bundle to begin with.

        Raises:
            ConfigurationError: there is none that can be used.
        """
        ...

    def newer(self, now: int) -> bytes | None:
        """A bundle that replaces the one given last; None: that one stays."""
        ...


class OwnCertificates:
    """Issued by the console's own authority, each with a new key, which is in memory alone.

    Args:
        authority: issues them.
        address: of this host now; None: it has none that others reach.
        serial: makes random serials.
    """

    def __init__(
        self, authority: TlsAuthority, address: Address | None, serial: Callable[[], int]
    ) -> None:
        self._authority = authority
        self._address = address
        self._serial = serial
        self._renew_at = 0

    def first(self, now: int) -> bytes:
        """As of `CertificateSource`."""
        key = ec.generate_private_key(ec.SECP256R1())
        leaf = self._authority.issue(
            key.public_key(), now=now, serial=self._serial(), address=self._address
        )
        certificate = x509.load_der_x509_certificate(leaf)
        self._renew_at = renewal_time(now, _end(certificate))
        return key_pem(key) + certificate.public_bytes(Encoding.PEM)

    def newer(self, now: int) -> bytes | None:
        """As of `CertificateSource`: at two thirds of the time; none once the authority ended."""
        if now < self._renew_at:
            return None
        try:
            return self.first(now)
        except ConfigurationError as error:
            _log.error("%s; %s", error, error.hint)
            self._renew_at = now + 3600  # to be said again
            return None


class FileCertificates:
    """The operator's files, read again when they change, as a program that renews them does.

    Args:
        certificate: the chain, the server's first, PEM.
        key: the private key, PEM, without a passphrase.
        name: that the certificate must have.
    """

    def __init__(self, certificate: Path, key: Path, name: str) -> None:
        self._paths = certificate, key
        self._name = name
        self._state: object = None

    def first(self, now: int) -> bytes:
        """As of `CertificateSource`."""
        self._state = self._look()
        chain, key = (_read(path) for path in self._paths)
        check_bundle(chain, key, self._name, now)
        return key.rstrip() + b"\n" + chain

    def newer(self, now: int) -> bytes | None:
        """As of `CertificateSource`: when one of the files is another one, and both fit."""
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
    """Two thirds into the time from `issued` to `end`, seconds since the epoch."""
    return issued + 2 * (end - issued) // 3


def check_bundle(chain: bytes, key: bytes, name: str, now: int) -> None:
    """Check that a chain and a key (PEM) can serve `name` at `now`. Pure.

    Raises:
        ConfigurationError: they cannot; the message says why.
    """
    try:
        leaf = x509.load_pem_x509_certificates(chain)[0]
    except ValueError as error:
        raise ConfigurationError("--tls-cert has no PEM certificate", "name the chain") from error
    try:
        own = load_pem_private_key(key, None)
    except (ValueError, TypeError) as error:
        raise ConfigurationError(
            "--tls-key has no private key", "name a PEM file that has no passphrase"
        ) from error
    form = Encoding.DER, PublicFormat.SubjectPublicKeyInfo
    if own.public_key().public_bytes(*form) != leaf.public_key().public_bytes(*form):
        raise ConfigurationError(
            "--tls-key is not the key of --tls-cert", "the server's own certificate comes first"
        )
    if now > _end(leaf):
        raise ConfigurationError("the certificate of --tls-cert has expired", "renew it")
    if not _names(leaf, name):
        raise ConfigurationError(
            f"the certificate of --tls-cert is not for {name}", "give its name with --name"
        )


def _names(leaf: x509.Certificate, name: str) -> bool:
    """Whether `leaf` has `name`, or a wildcard for its first label (RFC 9525 section 6.3)."""
    try:
        found = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return False
    names = {each.lower() for each in found.get_values_for_type(x509.DNSName)}
    return not names.isdisjoint({name, f"*.{name.partition('.')[2]}"})


def _end(certificate: x509.Certificate) -> int:
    return int(certificate.not_valid_after_utc.timestamp())


def _read(path: Path) -> bytes:
    """A file of the operator; it may be a link, as those of ACME clients are."""
    missing = ConfigurationError(f"there is no {path}", "name a PEM file")
    return files.read_own(path, _MAX_FILE, missing, link=True)
