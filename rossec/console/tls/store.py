"""The TLS authority on disk: `tls.key` and `tls.pem` in the console's own directory. A shell.

The key is made with mode 0600 and O_EXCL, never printed, and left out of backups: who restores the
authority of the robots makes a new one for browsers. A key and a certificate that do not belong
together, as a crash between the two leaves them, are refused; `renew` makes both anew.
"""

import os
import secrets
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from rossec import files
from rossec.authority.console import messages
from rossec.console.tls.authority import Address, TlsAuthority
from rossec.enrollment import address
from rossec.errors import ConfigurationError

DIRECTORY: Final = messages.DIRECTORY
KEY, CERTIFICATE = messages.TLS_KEY, messages.TLS_CERTIFICATE
_MAX_FILE: Final = 8 * 1024
_NONE: Final = ConfigurationError(
    "the console has no TLS authority", "make one: rossec console tls --renew, or --lan"
)
_RENEW: Final = "make a new one: rossec console tls --renew"


def open_authority(directory: Path) -> TlsAuthority:
    """The authority in `directory`. Its validity is not checked here.

    Raises:
        ConfigurationError: there is none, or it is damaged, or others can read its key.
        PathRefused: others can write there.
    """
    key = _read_key(directory / KEY)
    pem = files.read_own(directory / CERTIFICATE, _MAX_FILE, _NONE)
    try:
        data = x509.load_pem_x509_certificate(pem).public_bytes(Encoding.DER)
    except ValueError as error:
        raise ConfigurationError(f"{CERTIFICATE} is damaged", _RENEW) from error
    return TlsAuthority.load(key, data)


def exists(directory: Path) -> bool:
    """Whether there is an authority in `directory`, be it whole or not."""
    return (directory / KEY).exists() or (directory / CERTIFICATE).exists()


def renew(directory: Path, name: str, host: Address | None, now: int) -> TlsAuthority:
    """Make a new authority for `name` with a new key, in the place of one that is there.

    Raises:
        NotWritten: the disk refused it.
        PathRefused: others can write there.
    """
    files.make_private_directory(directory)
    with files.locked_directory(directory):
        key = ec.generate_private_key(ec.SECP256R1())
        made = TlsAuthority.create(key, name, host, now=now, serial=random_serial())
        fresh = directory / f"{KEY}.{secrets.token_hex(8)}"
        files.create(fresh, key_pem(key))
        fresh.replace(directory / KEY)
        pem = x509.load_der_x509_certificate(made.data).public_bytes(Encoding.PEM)
        files.replace(directory / CERTIFICATE, pem, 0o644)
    return made


def authority_for(
    directory: Path, name: str, host: Address | None, now: int, *, rename: bool
) -> TlsAuthority:
    """The authority for `name`, made if there is none.

    Raises:
        ConfigurationError: the one that is there is for another name, and not to be replaced
            (`rename`); it is damaged; it is not valid now.
    """
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
    """The address at which others probably reach this host; None: there is none."""
    found = map(ip_address, address.own_addresses())
    return next((each for each in found if not each.is_loopback and not each.is_link_local), None)


def random_serial() -> int:
    """127 random bits, not 0 (RFC 5280 section 4.1.2.2)."""
    return secrets.randbits(127) + 1


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """PKCS#8, without a passphrase."""
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    pem = files.read_own(path, _MAX_FILE, _NONE)
    if os.lstat(path).st_mode & 0o077:
        raise ConfigurationError(f"{path} can be read by others", _RENEW)
    try:
        key = load_pem_private_key(pem, None)
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{KEY} is damaged", _RENEW) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.curve.name != "secp256r1":
        raise ConfigurationError(f"{KEY} is not a P-256 key", _RENEW)
    return key
