"""TLS of one operator's routers: their authority, their certificates, and what they share. Pure.

P-256: what every TLS library knows.
"""

from dataclasses import dataclass, field
from ipaddress import ip_address
from typing import Final, Self

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from ca.builder import tls_authority, tls_server
from ca.certificates import BACKDATE
from rossec.errors import ConfigurationError
from rossec.overlay import router_settings
from rossec.overlay.documents import MAX_LOCATORS, check_locator, is_texts, read_document, write_document
from rossec.overlay.router_settings import ROUTER_NAME, Accounts

DAY: Final = 86400
LIFETIME: Final = 20 * 365 * DAY  # every account file has it: a new authority means new files for all
LEAF_LIFETIME: Final = 365 * DAY
_ROOT: Final = "rossec routers"
_DAMAGED: Final = "put back a copy of the directory, or remove it and give out new accounts"
MAX_SHARE_FILE: Final = 2 * router_settings.MAX_ACCOUNTS_FILE
_FORM: Final = "rossec-routers"
_KEYS: Final = frozenset({"authority_key", "authority", "accounts", "join"})
_HINT: Final = "write it again, at the other router: rossec router share"


@dataclass(frozen=True)
class RouterAuthority:
    """The authority: its key, its certificate. Times are seconds since the epoch."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate

    @classmethod
    def create(cls, key: ec.EllipticCurvePrivateKey, *, now: int, serial: int) -> Self:
        # Trusted by sites for routers alone (no browser, no system store): so without name constraints, as
        # the operator may move a router to any host. It issues to no other authority, for TLS servers alone.
        return cls(key, tls_authority(key, _ROOT, serial, (now - BACKDATE, now + LIFETIME)))

    @classmethod
    def load(cls, key: bytes, certificate: bytes) -> Self:
        found = load_key(key)
        try:
            (root,) = x509.load_pem_x509_certificates(certificate)
        except ValueError:
            raise ConfigurationError("the routers' certificate is damaged", _DAMAGED) from None
        if root.public_key() != found.public_key():
            raise ConfigurationError("the routers' authority has another key", _DAMAGED)
        return cls(found, root)

    @property
    def pem(self) -> bytes:
        return self.certificate.public_bytes(Encoding.PEM)

    def issue(
        self, key: ec.EllipticCurvePublicKey, hosts: tuple[str, ...], *, now: int, serial: int
    ) -> bytes:
        end = int(self.certificate.not_valid_after_utc.timestamp())
        if not int(self.certificate.not_valid_before_utc.timestamp()) <= now < end:
            raise ConfigurationError("the routers' authority is not valid now", "check the clock")
        period, names = (now - BACKDATE, min(now + LEAF_LIFETIME, end)), map(_general, hosts)
        made = tls_server(self.key, self.certificate.subject, key, ROUTER_NAME, names, serial, period)
        return made.public_bytes(Encoding.PEM)

    def is_current(self, certificate: bytes, key: bytes, hosts: tuple[str, ...], *, now: int) -> bool:
        # One that has less than a third of its time left is not.
        try:
            (leaf,) = x509.load_pem_x509_certificates(certificate)
            leaf.verify_directly_issued_by(self.certificate)
            if leaf.public_key() != load_key(key).public_key():
                return False
            names = leaf.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except Exception:  # noqa: BLE001 - whatever is wrong with it, it is made anew
            return False
        start, end = leaf.not_valid_before_utc.timestamp(), leaf.not_valid_after_utc.timestamp()
        return list(names) == list(map(_general, hosts)) and now < end - (end - start) / 3


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def load_key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    try:
        key = load_pem_private_key(pem, None)
    except (ValueError, TypeError):
        raise ConfigurationError("a key of the router is damaged", _DAMAGED) from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.curve.name != "secp256r1":
        raise ConfigurationError("a key of the router is not a P-256 key", _DAMAGED)
    return key


def _general(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


@dataclass(frozen=True)
class Share:
    """What a further router needs. All of the file is secret; with it one is the operator."""

    authority: RouterAuthority = field(repr=False)
    accounts: Accounts
    join: tuple[str, ...]  # where the router listens that wrote it, and those that it joins itself

    def write(self) -> bytes:
        return write_document(
            _FORM,
            {
                "authority_key": key_pem(self.authority.key).decode(),
                "authority": self.authority.pem.decode(),
                "accounts": self.accounts.write().decode(),
                "join": list(self.join),
            },
        )

    @classmethod
    def read(cls, data: bytes) -> Self:
        found = read_document(data, _FORM, _KEYS, limit=MAX_SHARE_FILE, hint=_HINT)
        match found:
            case {
                "authority_key": str() as key,
                "authority": str() as pem,
                "accounts": str() as listed,
                "join": list() as join,
            } if is_texts(join) and 0 < len(join) <= MAX_LOCATORS:
                authority = RouterAuthority.load(key.encode(), pem.encode())
                for each in join:
                    check_locator(each)
                return cls(authority, Accounts.read(listed.encode()), tuple(join))
        raise ConfigurationError(f"the {_FORM} file has a value of another type", _HINT)
