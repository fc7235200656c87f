"""Which routers carry a site's links, and its seat there: the seat file. Pure.

`rossec router seats add` writes it, the operator of the routers hands it to the site, and `rossec
relay seat` keeps it. It is JSON, with a password in it: whoever has the file has the seat. A
locator is `protocol/host:port` and nothing more: what Zenoh takes behind a `?` or `#` would change
the settings of the session. Routers behind TLS are verified by `root_certificate` alone, never by
the authorities of the web.
"""

import re
from dataclasses import asdict, dataclass, field, fields
from typing import Final, Self

from cryptography import x509

from rossec.errors import ConfigurationError
from rossec.overlay.documents import is_texts, read_document, write_document
from rossec.overlay.mailboxes import is_seat

MAX_FILE: Final = 16 * 1024
MAX_LOCATORS: Final = 16
OPEN_SEAT: Final = "open"  # of everybody, at a router without seats
_PASSWORD: Final = re.compile(r"[A-Za-z0-9_-]{22,128}", re.ASCII)
_LOCATOR: Final = re.compile(
    r"(?P<protocol>quic|tls|tcp)/"
    r"(?P<host>\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9]([A-Za-z0-9._-]{0,252}))"
    r":(?P<port>[0-9]{1,5})",
    re.ASCII,
)
_FORM: Final = "rossec-seat"
_AGAIN: Final = "ask the operator of the router for it again: rossec router seats show NAME"


@dataclass(frozen=True)
class Routers:
    """The routers of a site.

    Attributes:
        locators: where they listen: `tls/router.example.org:7447`; any of them will do.
        seat: name of the customer, a part of its keys (`rossec.overlay.mailboxes`).
        password: of the seat; empty at a router that is open to all.
        root_certificate: PEM, of the authority that certified the routers; empty without TLS.
    """

    locators: tuple[str, ...]
    seat: str
    password: str = field(default="", repr=False)
    root_certificate: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        """Raise `ConfigurationError` unless all of it is in form."""
        if not 0 < len(self.locators) <= MAX_LOCATORS:
            raise ConfigurationError(f"a seat names 1 to {MAX_LOCATORS} routers", _AGAIN)
        for each in self.locators:
            check_locator(each)
        check_seat(self.seat)
        if self.seat != OPEN_SEAT or self.password:
            check_password(self.password)
        _check_root(self.root_certificate, needed=any(map(is_encrypted, self.locators)))

    @classmethod
    def read(cls, data: bytes) -> Self:
        """The content of a seat file.

        Raises:
            ConfigurationError: it is not one.
        """
        found = read_document(
            data, _FORM, frozenset(each.name for each in fields(cls)), limit=MAX_FILE, hint=_AGAIN
        )
        locators = found.pop("locators")
        if not is_texts(locators) or not is_texts(list(found.values())):
            raise ConfigurationError("the seat file has a value of another type", _AGAIN)
        return cls(tuple(locators), **found)

    def write(self) -> bytes:
        """The seat file: it holds the password."""
        return write_document(_FORM, asdict(self))


def check_seat(seat: str) -> str:
    """`seat`, if it is the name of one.

    Raises:
        ConfigurationError: it is not.
    """
    if not is_seat(seat):
        raise ConfigurationError(
            f"{seat[:40]!a} is not the name of a seat", "at most 32 of the characters a-z and 0-9"
        )
    return seat


def check_password(password: str) -> str:
    """`password`, if it is one that a router made; it is in no message.

    Raises:
        ConfigurationError: it is not.
    """
    if not _PASSWORD.fullmatch(password):
        raise ConfigurationError("the password of a seat is not in form", _AGAIN)
    return password


def check_locator(locator: str) -> tuple[str, str, int]:
    """Protocol, host (without brackets) and port of a locator.

    Raises:
        ConfigurationError: it is not one.
    """
    match = _LOCATOR.fullmatch(locator)
    if match is None or not 0 < int(match["port"]) < 1 << 16:
        raise ConfigurationError(
            f"{locator[:80]!a} is not the address of a router",
            "it looks like tls/router.example.org:7447, with quic/, tls/ or tcp/",
        )
    return match["protocol"], match["host"].strip("[]"), int(match["port"])


def is_encrypted(locator: str) -> bool:
    """Whether a locator's router is verified, and what is sent to it encrypted."""
    return not locator.startswith("tcp/")


def _check_root(pem: str, *, needed: bool) -> None:
    if not pem and not needed:
        return
    try:
        (_certificate,) = x509.load_pem_x509_certificates(pem.encode())
    except ValueError:
        raise ConfigurationError(
            "a seat at a router with TLS needs the certificate of its authority", _AGAIN
        ) from None
