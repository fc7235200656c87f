"""What a router is told by its operator, and Zenoh's settings that follow from it. Pure.

What was told is kept in the router's directory, for the seat files that name it. A router does not
answer in Zenoh's administration, is found by no scouting, and keeps what is malformed or too large
for a mailbox from everybody. Routers with seats join each other over TLS or QUIC alone: the side
that connects knows by the certificate whom it joined, and would otherwise forward nothing.
"""

import ipaddress
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final, Self

from rossec.errors import ConfigurationError
from rossec.overlay.documents import is_texts, read_document, write_document
from rossec.overlay.link_frames import MAX_FRAME
from rossec.overlay.routers import MAX_LOCATORS, check_locator, is_encrypted
from rossec.overlay.seats import ROUTER_USER, Seats, open_access_control
from rossec.overlay.zenoh_settings import COMMON

LISTEN: Final = ("tls/[::]:7447",)
MAX_FILE: Final = 16 * 1024
MAX_HOSTS: Final = 16
_MESSAGE: Final = MAX_FRAME + 4096  # bytes, with Zenoh's own around a frame
_SIZE_LIMIT: Final = {
    "flows": ["ingress"],
    "messages": ["put"],
    "key_exprs": ["**"],
    "size_limit": MAX_FRAME,
}
_FORM: Final = "rossec-router"
_HINT: Final = "remove the file, and start the router with --listen, --join and --host again"
_LOCAL: Final = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True)
class RouterSettings:
    """One router.

    Attributes:
        hosts: names and addresses by which relays reach it.
        listen: where it listens, `tls/[::]:7447`.
        join: locators of other routers of the operator.
    """

    hosts: tuple[str, ...] = ()
    listen: tuple[str, ...] = LISTEN
    join: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise `ConfigurationError` unless all of it is in form."""
        if not self.listen or max(map(len, (self.listen, self.join))) > MAX_LOCATORS:
            raise ConfigurationError(
                f"a router listens at 1 to {MAX_LOCATORS} addresses, and joins as many at most"
            )
        if len(self.hosts) > MAX_HOSTS:
            raise ConfigurationError(f"a router has at most {MAX_HOSTS} names and addresses")
        for locator in (*self.listen, *self.join):
            check_locator(locator)
        for host in self.hosts:
            check_locator(_locator("tls", host, 1))
        for locator in self.join:
            if is_wildcard(check_locator(locator)[1]):
                raise ConfigurationError(
                    f"{locator} is no router to join", "give the address of another router"
                )

    @classmethod
    def read(cls, data: bytes) -> Self:
        """The content of the file.

        Raises:
            ConfigurationError: it is not one.
        """
        keys = frozenset(each.name for each in fields(cls))
        found = read_document(data, _FORM, keys, limit=MAX_FILE, hint=_HINT)
        if not all(map(is_texts, found.values())):
            raise ConfigurationError(f"the {_FORM} file has a value of another type", _HINT)
        return cls(**{name: tuple(value) for name, value in found.items()})

    def write(self) -> bytes:
        """The file."""
        return write_document(_FORM, asdict(self))

    @property
    def certified(self) -> tuple[str, ...]:
        """What the router's certificate is for: its hosts, where it listens, and this host."""
        addresses = (check_locator(each)[1] for each in self.listen)
        named = (each for each in addresses if not is_wildcard(each))
        return tuple(dict.fromkeys((*self.hosts, *named, *_LOCAL)))

    @property
    def locators(self) -> tuple[str, ...]:
        """Where relays find it, and then the routers that it joins.

        Raises:
            ConfigurationError: it listens at every address, and no host was said.
        """
        own = self.own_locators
        if not own:
            raise ConfigurationError(
                "it is not known by which name relays reach this router",
                "say it once: --host router.example.org, or an address",
            )
        return tuple(dict.fromkeys((*own, *self.join)))[:MAX_LOCATORS]

    @property
    def own_locators(self) -> tuple[str, ...]:
        """Where relays find it, as far as that is known."""
        return tuple(locator for each in self.listen for locator in self._reached(each))

    def _reached(self, listened: str) -> list[str]:
        protocol, host, port = check_locator(listened)
        if not is_wildcard(host):
            return [listened]
        return [_locator(protocol, each, port) for each in self.hosts]


@dataclass(frozen=True)
class RouterFiles:
    """The files that Zenoh reads by itself."""

    users: Path
    root_certificate: Path
    key: Path
    certificate: Path


def zenoh_settings(
    settings: RouterSettings, seats: Seats | None, files: RouterFiles
) -> dict[str, object]:
    """Paths of Zenoh's configuration with their values; without seats the router is open to all.

    Raises:
        ConfigurationError: it has seats, and joins another without TLS.
    """
    found = {
        **COMMON,
        "mode": "router",
        "listen/endpoints": list(settings.listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(settings.join),
        "connect/timeout_ms": -1,  # it begins without those that are down, and tries for ever
        "connect/exit_on_failure": False,
        "transport/link/rx/max_message_size": _MESSAGE,
        "low_pass_filter": [_SIZE_LIMIT],
        **_tls(settings, files),
    }  # fmt: skip
    if seats is None:
        return {**found, "access_control": open_access_control()}
    _check_joined(settings)
    return {
        **found,
        **_regions(seats.region),
        "access_control": seats.access_control(),
        "transport/auth/usrpwd/user": ROUTER_USER,
        "transport/auth/usrpwd/password": seats.router,
        "transport/auth/usrpwd/dictionary_file": str(files.users),
    }


def nested(settings: Mapping[str, object]) -> dict[str, Any]:
    """The settings as the tree that `zenohd --config` reads."""
    tree: dict[str, Any] = {}
    for path, value in settings.items():
        *above, last = path.split("/")
        branch = tree
        for each in above:
            branch = branch.setdefault(each, {})
        branch[last] = value
    return tree


def is_wildcard(host: str) -> bool:
    """Whether `host` is every address, where one can listen and none can connect."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False


def _tls(settings: RouterSettings, files: RouterFiles) -> dict[str, object]:
    if not any(map(is_encrypted, (*settings.listen, *settings.join))):
        return {}
    return {
        "transport/link/tls/root_ca_certificate": str(files.root_certificate),
        "transport/link/tls/listen_private_key": str(files.key),
        "transport/link/tls/listen_certificate": str(files.certificate),
        "transport/link/tls/verify_name_on_connect": True,
    }


def _regions(own: str) -> dict[str, object]:
    """Customers and what they connect as routers are below; their routes are not the routers' own.

    Else one who connects as a router to two of them, and claims that the way is short, would be
    sent what they have for each other, which the access control then drops.
    """
    below = [{"modes": ["client", "peer"]}], [{"region_names": [own], "negated": True}]
    south = [{"filters": filters} for filters in below]
    return {"region_name": own, "gateway": {"south": south}}


def _check_joined(settings: RouterSettings) -> None:
    plain = [each for each in settings.join if not is_encrypted(each)]
    if plain:
        raise ConfigurationError(
            f"a router with seats does not join {plain[0]}: nothing says who answers there",
            "join it by tls/ or quic/",
        )


def _locator(protocol: str, host: str, port: int) -> str:
    return f"{protocol}/[{host}]:{port}" if ":" in host else f"{protocol}/{host}:{port}"
