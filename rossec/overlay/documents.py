"""The JSON files of relays and routers: a relay's peers, its descriptor, and the account file. Pure.

Each is one object that names its form, with exactly these keys.
"""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Final, NoReturn, Self

from cryptography import x509

from ca.certificates import Identity
from ca.errors import NameRefused
from ca.names import alias_of, check_domain, check_label, display_name, is_relay_name, split_alias
from rossec.errors import ConfigurationError, RelayRefused
from rossec.overlay.link_frames import BOX, is_account, is_inbox

VERSION: Final = 1
MAX_PEERS: Final = 64
MAX_PEERS_FILE: Final = 64 * 1024
_FORM: Final = "rossec-overlay"
_BOX: Final = re.compile(r"[0-9a-f]{32}", re.ASCII)
_HINT: Final = "it is written by `rossec relay descriptor`, `add` and `remove`: use these"
MAX_DESCRIPTOR: Final = 4 * 1024
_RELAY_DESCRIPTORS_FORM: Final = "rossec-relay-descriptor"
_RELAY_DESCRIPTORS_HINT: Final = "ask for the file that `rossec relay descriptor` wrote at the other site"
MAX_ACCOUNT_FILE: Final = 16 * 1024
MAX_LOCATORS: Final = 16
OPEN_ACCOUNT: Final = "open"  # of everybody, at a router without accounts
_PASSWORD: Final = re.compile(r"[A-Za-z0-9_-]{22,128}", re.ASCII)
# Nothing more: what Zenoh takes behind a `?` or `#` would change the settings of the session.
_LOCATOR: Final = re.compile(
    r"(?P<protocol>quic|tls|tcp)/"
    r"(?P<host>\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9]([A-Za-z0-9._-]{0,252}))"
    r":(?P<port>[0-9]{1,5})",
    re.ASCII,
)
_ROUTERS_FORM: Final = "rossec-account"
_AGAIN: Final = "ask the operator of the router for it again: rossec router accounts show NAME"


def read_document(data: bytes, form: str, keys: frozenset[str], *, limit: int, hint: str) -> dict[str, Any]:
    if len(data) > limit:
        raise ConfigurationError(f"a {form} file has at most {limit} bytes", hint)
    # A key that occurs twice, `NaN` and what is nested without end: RFC 8259 section 4 leaves the first to
    # each reader.
    try:
        found = json.loads(data, object_pairs_hook=_once, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise ConfigurationError(f"the {form} file is not JSON", hint) from None
    # A file of another kind is told from a damaged one: the message says what was mistaken.
    if not isinstance(found, dict) or form not in found:
        raise ConfigurationError(f"this is no {form} file", hint)
    version = found.pop(form)
    if version != VERSION or not isinstance(version, int) or isinstance(version, bool):
        raise ConfigurationError(f"the {form} file is of another version", hint)
    if found.keys() != keys:
        raise ConfigurationError(f"the {form} file has other entries than it should", hint)
    return found


def write_document(form: str, entries: Mapping[str, Any]) -> bytes:
    return json.dumps({form: VERSION, **entries}, indent=1).encode() + b"\n"


def is_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(each, str) for each in value)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key occurs twice")
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


@dataclass(frozen=True)
class Peer:
    """A relay of another site, as `label`; without its descriptor, `relay` and `inbox` are empty."""

    # For each peer there is an inbox of its own, told to nobody else, so that each peer is cut alone
    # (decision 0034). A link that arrives in it must come from that peer's domain and relay.

    label: str
    box: str = field(repr=False)  # of the own inbox that is told to it alone, hexadecimal
    domain: str | None = None  # label of its foreign domain; empty: the own one; None: nobody has said it
    relay: str = ""  # the name it is certified for
    inbox: str = field(default="", repr=False)  # the key of its inbox for this relay

    def __post_init__(self) -> None:
        try:
            check_label(self.label)
            if self.domain:
                check_label(self.domain)
        except NameRefused as error:
            raise ConfigurationError(str(error), error.hint) from error
        if _BOX.fullmatch(self.box) is None:
            raise ConfigurationError(f"the inbox for {self.label} has {2 * BOX} digits", _HINT)
        if not self.relay and not self.inbox:
            return
        if not is_relay_name(self.relay):
            raise ConfigurationError(
                f"{self.relay[:255]!a} is not the name of a relay", "/relay, or /relay/attic"
            )
        if not is_inbox(self.inbox) or self.domain is None:
            raise ConfigurationError(f"the descriptor of {self.label} is not complete", _HINT)

    @property
    def is_complete(self) -> bool:
        """Whether its descriptor is here, so that links with it can be made."""
        return bool(self.relay)

    @property
    def name(self) -> str:
        return alias_of(self.domain, self.relay) if self.domain else self.relay

    @property
    def shown(self) -> str:
        return display_name(self.domain or "", self.relay) if self.relay else ""

    def check(self, found: Identity) -> None:
        """Return if an authenticated relay is this peer."""
        alias = split_alias(found.name) if found.is_foreign else None
        label, name = ("", found.name) if alias is None else alias
        if not self.is_complete or (label, name) != (self.domain, self.relay):
            raise RelayRefused(
                f"{display_name(label, name)} is at the inbox of {self.label},"
                f" not {self.shown or 'a relay whose descriptor is here'}",
                f"exchange descriptors anew: rossec relay remove {self.label}",
            )


Peers = Mapping[str, Peer]  # by label


def checked_peers(peers: Iterable[Peer]) -> dict[str, Peer]:
    found: dict[str, Peer] = {}
    for each in peers:
        for other in found.values():
            if each.label == other.label:
                raise ConfigurationError(f"two peers are called {each.label}", "give each its own label")
            same_relay = each.is_complete and (each.domain, each.relay) == (other.domain, other.relay)
            same_inbox = each.is_complete and each.inbox == other.inbox
            if same_relay or each.box == other.box or same_inbox:
                raise ConfigurationError(
                    f"{other.label} and {each.label} are one relay", f"rossec relay remove {other.label}"
                )
        found[each.label] = each
    if len(found) > MAX_PEERS:
        raise ConfigurationError(f"at most {MAX_PEERS} peers of a relay", "run another relay")
    return found


def read_peers(data: bytes, name: str) -> dict[str, Peer]:
    try:
        found = read_document(data, _FORM, frozenset({"peers"}), limit=MAX_PEERS_FILE, hint=_HINT)
    except ConfigurationError as error:
        raise ConfigurationError(f"{name}: {error}", error.hint) from error
    rows = found["peers"]
    if not isinstance(rows, list):
        raise ConfigurationError(f"{name} is not a list of peers of this form", _HINT)
    return checked_peers(_peer(row, name) for row in rows)


def write_peers(peers: Peers) -> bytes:
    rows = [asdict(each) for _, each in sorted(peers.items())]
    return write_document(_FORM, {"peers": rows})


def _peer(row: object, name: str) -> Peer:
    match row:
        case {
            "label": str() as label,
            "box": str() as box,
            "domain": (str() | None) as domain,
            "relay": str() as relay,
            "inbox": str() as inbox,
            **rest,
        } if not rest:
            return Peer(label, box, domain, relay, inbox)
    raise ConfigurationError(f"{name} has a peer that is not in form", _HINT)


@dataclass(frozen=True)
class RelayDescriptor:
    """What one relay's operator hands to another's, to link their sites."""

    # Not signed: the peer proves by its certificate who it is, and a forged descriptor only leads to an inbox
    # where that proof fails. Whoever reads it can send to that inbox, so it is handed to its receiver
    # alone. Routers are not in it: each site has its own.

    domain: str  # the trust domain of the relay, as its authority has named it
    relay: str
    inbox: str = field(repr=False)  # the key of its inbox for the receiver of the descriptor

    def __post_init__(self) -> None:
        try:
            check_domain(self.domain)
        except NameRefused as error:
            raise RelayRefused(f"in the relay's descriptor: {error}", _RELAY_DESCRIPTORS_HINT) from error
        if not is_relay_name(self.relay) or not is_inbox(self.inbox):
            raise RelayRefused("the descriptor names no relay, or no inbox", _RELAY_DESCRIPTORS_HINT)

    @classmethod
    def read(cls, data: bytes) -> Self:
        keys = frozenset(each.name for each in fields(cls))
        refused = RelayRefused("this is not the descriptor of a relay", _RELAY_DESCRIPTORS_HINT)
        try:
            found = read_document(
                data, _RELAY_DESCRIPTORS_FORM, keys, limit=MAX_DESCRIPTOR, hint=_RELAY_DESCRIPTORS_HINT
            )
        except ConfigurationError as error:
            raise refused from error
        if not is_texts(list(found.values())):
            raise refused
        return cls(**found)

    def write(self) -> str:
        return write_document(_RELAY_DESCRIPTORS_FORM, asdict(self)).decode()


@dataclass(frozen=True)
class Routers:
    """Which routers carry a site's links, and its account there: the account file.

    `rossec router accounts add` writes it, the operator of the routers hands it to the site, and `rossec
    relay account` keeps it. Whoever has the file has the account. Routers behind TLS are verified by
    `root_certificate` alone, never by the authorities of the web.
    """

    locators: tuple[str, ...]  # where they listen: any of them will do
    account: str  # name of the customer, a part of its keys (`rossec.overlay.link_frames`)
    password: str = field(default="", repr=False)  # empty at a router that is open to all
    root_certificate: str = field(default="", repr=False)  # PEM; empty without TLS

    def __post_init__(self) -> None:
        if not 0 < len(self.locators) <= MAX_LOCATORS:
            raise ConfigurationError(f"an account names 1 to {MAX_LOCATORS} routers", _AGAIN)
        for each in self.locators:
            check_locator(each)
        check_account(self.account)
        if self.account != OPEN_ACCOUNT or self.password:
            check_password(self.password)
        if not self.root_certificate and not any(map(is_encrypted, self.locators)):
            return
        try:
            (_certificate,) = x509.load_pem_x509_certificates(self.root_certificate.encode())
        except ValueError:
            raise ConfigurationError(
                "an account at a router with TLS needs the certificate of its authority", _AGAIN
            ) from None

    @classmethod
    def read(cls, data: bytes) -> Self:
        keys = frozenset(each.name for each in fields(cls))
        found = read_document(data, _ROUTERS_FORM, keys, limit=MAX_ACCOUNT_FILE, hint=_AGAIN)
        locators = found.pop("locators")
        if not is_texts(locators) or not is_texts(list(found.values())):
            raise ConfigurationError("the account file has a value of another type", _AGAIN)
        return cls(tuple(locators), **found)

    def write(self) -> bytes:
        return write_document(_ROUTERS_FORM, asdict(self))


def check_account(account: str) -> str:
    if not is_account(account):
        raise ConfigurationError(
            f"{account[:40]!a} is not the name of an account", "at most 32 of the characters a-z and 0-9"
        )
    return account


def check_password(password: str) -> str:
    if not _PASSWORD.fullmatch(password):
        raise ConfigurationError("the password of an account is not in form", _AGAIN)
    return password


def check_locator(locator: str) -> tuple[str, str, int]:
    match = _LOCATOR.fullmatch(locator)
    if match is None or not 0 < int(match["port"]) < 1 << 16:
        raise ConfigurationError(
            f"{locator[:80]!a} is not the address of a router",
            "it looks like tls/router.example.org:7447, with quic/, tls/ or tcp/",
        )
    return match["protocol"], match["host"].strip("[]"), int(match["port"])


def is_encrypted(locator: str) -> bool:
    return not locator.startswith("tcp/")
