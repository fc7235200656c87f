"""What a router is told by its operator, its accounts, and Zenoh's settings that follow from both. Pure.

Accounts are the accounts at the routers of one operator. An account may read the inboxes below its own name
and send to any inbox; everything else is denied. What the settings are for is in sections 3.6 and 4 of
docs/spec/overlay.md.
"""

import base64
import hashlib
import ipaddress
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from rossec.errors import ConfigurationError
from rossec.overlay import documents
from rossec.overlay.link_frames import MAX_FRAME

MAX_ACCOUNTS_FILE: Final = 256 * 1024
MAX_ACCOUNTS: Final = 512  # each costs two rules, which a router looks through for every new session
ROUTER_USER: Final = "_router"  # no account's name has this character
ROUTER_NAME: Final = "rossec router"  # common name of every router's certificate
EVERY_INBOX: Final = "rossec/1/*/*"  # two segments: a put to rossec/** fits no rule
_FORM: Final = "rossec-accounts"
_HINT: Final = "it is written by `rossec router accounts`: put back a copy"
_SEND: Final = "send"
_ACCEPTED: Final = "router-accepted"
_JOINED: Final = "router-joined"
_FORWARD: Final = ("forward", "forward-declared")
Entry = dict[str, Any]
LEASE_MS: Final = 2000
_WAIT_US: Final = 50_000
_DROP: Final = "transport/link/tx/queue/congestion_control/drop/"
COMMON: Final[dict[str, object]] = {
    "listen/endpoints": [],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "adminspace/enabled": False,
    "timestamping/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": LEASE_MS,
    "transport/unicast/open_timeout": 1000,
    "transport/unicast/accept_timeout": 1000,
    f"{_DROP}wait_before_drop": _WAIT_US,
    f"{_DROP}max_wait_before_drop_fragments": _WAIT_US,
    "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
}
"""Of routers and of relays."""

LISTEN: Final = ("tls/[::]:7447",)
MAX_SETTINGS_FILE: Final = 16 * 1024
MAX_HOSTS: Final = 16
_MESSAGE: Final = MAX_FRAME + 4096  # bytes, with Zenoh's own around a frame
_SIZE_LIMIT: Final = {"flows": ["ingress"], "messages": ["put"], "key_exprs": ["**"], "size_limit": MAX_FRAME}
_ROUTER_SETTINGS_FORM: Final = "rossec-router"
_ROUTER_SETTINGS_HINT: Final = "remove the file, and start the router with --listen, --join and --host again"
_LOCAL: Final = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True)
class Accounts:
    """The passwords of the accounts, by name, and that by which the operator's routers join each other."""

    router: str = field(repr=False)
    passwords: Mapping[str, str] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        documents.check_password(self.router)
        if len(self.passwords) > MAX_ACCOUNTS:
            raise ConfigurationError(f"at most {MAX_ACCOUNTS} accounts", "remove what nobody uses")
        for account, password in self.passwords.items():
            if documents.check_account(account) == documents.OPEN_ACCOUNT:
                raise ConfigurationError(
                    f"{documents.OPEN_ACCOUNT} is the account at a router without accounts",
                    "give it another name",
                )
            documents.check_password(password)

    @property
    def region(self) -> str:
        return hashlib.sha256(b"rossec region " + self.router.encode()).hexdigest()[:32]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted(self.passwords))

    @classmethod
    def read(cls, data: bytes) -> Self:
        found = documents.read_document(
            data, _FORM, frozenset({"router", "accounts"}), limit=MAX_ACCOUNTS_FILE, hint=_HINT
        )
        match found:
            case {"router": str() as router, "accounts": dict() as accounts} if all(
                isinstance(each, str) for each in accounts.values()
            ):
                return cls(router, accounts)
        raise ConfigurationError(f"the {_FORM} file has a value of another type", _HINT)

    def write(self) -> bytes:
        return documents.write_document(_FORM, {"router": self.router, "accounts": dict(self.passwords)})

    def add(self, account: str, password: str) -> Self:
        if account in self.passwords:
            raise ConfigurationError(
                f"there is an account {account} already",
                f"its file again: rossec router accounts show {account}; a new password: remove it first",
            )
        return replace(self, passwords={**self.passwords, account: password})

    def remove(self, account: str) -> Self:
        self.password(account)
        return replace(
            self, passwords={name: each for name, each in self.passwords.items() if name != account}
        )

    def password(self, account: str) -> str:
        if account not in self.passwords:
            raise ConfigurationError(
                f"there is no account {account[:40]!a}", f"there are: {', '.join(self.names) or 'none'}"
            )
        return self.passwords[account]

    def dictionary(self) -> bytes:
        users = {**self.passwords, ROUTER_USER: self.router}
        return "".join(f"{name}:{each}\n" for name, each in sorted(users.items())).encode()

    def access_control(self) -> Entry:
        routers = [
            {"id": _ACCEPTED, "usernames": [ROUTER_USER]},
            {"id": _JOINED, "cert_common_names": [ROUTER_NAME]},
        ]
        rules = [_rule(_SEND, "ingress", "put", EVERY_INBOX)]
        subjects: list[Entry] = []
        policies: list[Entry] = []
        for account in self.names:
            # What only this account may: declare that it reads an inbox of its own, and get what is there.
            # Nothing allows that a declaration goes out to it: it would name an inbox of another account, or
            # tell by a pattern whether there is one that begins so, and with that all digits of it in turn.
            rules.append(_rule(f"read-{account}", "ingress", "declare_subscriber", _inboxes(account)))
            rules.append(_rule(f"get-{account}", "egress", "put", _inboxes(account)))
            subjects.append({"id": f"account-{account}", "usernames": [account]})
            policies.append(_policy(f"account-{account}", _SEND, f"read-{account}", f"get-{account}"))
        return _access_control(
            [*rules, *_forwarding(EVERY_INBOX)],
            [*subjects, *routers],
            [*policies, _policy(_ACCEPTED, *_FORWARD), _policy(_JOINED, *_FORWARD)],
        )


def open_access_control() -> Entry:
    return _access_control(
        _forwarding(_inboxes(documents.OPEN_ACCOUNT)),
        [{"id": "everybody"}],
        [_policy("everybody", *_FORWARD)],
    )


def _access_control(rules: list[Entry], subjects: list[Entry], policies: list[Entry]) -> Entry:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _forwarding(keys: str) -> list[Entry]:
    put, declare = _FORWARD
    return [_rule(put, "both", "put", keys), _rule(declare, "both", "declare_subscriber", keys)]


def _inboxes(account: str) -> str:
    return f"rossec/1/{account}/*"


def _rule(name: str, flow: str, message: str, keys: str) -> Entry:
    flows = ["ingress", "egress"] if flow == "both" else [flow]
    return {"id": name, "permission": "allow", "flows": flows, "messages": [message], "key_exprs": [keys]}


def _policy(subject: str, *rules: str) -> Entry:
    return {"rules": list(rules), "subjects": [subject]}


def client_settings(routers: documents.Routers) -> dict[str, object]:
    """Of a relay's session: with one of the routers, another one when that fails.

    It listens nowhere: no port of a site is open for it.
    """
    settings = {
        **COMMON,
        "mode": "client",
        "connect/endpoints": list(routers.locators),
        "connect/timeout_ms": 0,  # each is tried once; who opens the session tries again
        "connect/exit_on_failure": True,
    }
    if routers.password:
        settings["transport/auth/usrpwd/user"] = routers.account
        settings["transport/auth/usrpwd/password"] = routers.password
    if routers.root_certificate:
        root = base64.b64encode(routers.root_certificate.encode()).decode()
        settings["transport/link/tls/root_ca_certificate_base64"] = root
        settings["transport/link/tls/verify_name_on_connect"] = True
    return settings


@dataclass(frozen=True)
class RouterSettings:
    """What one router was told; kept in its directory, for the account files that name it."""

    hosts: tuple[str, ...] = ()  # names and addresses by which relays reach it
    listen: tuple[str, ...] = LISTEN
    join: tuple[str, ...] = ()  # locators of other routers of the operator

    def __post_init__(self) -> None:
        if not self.listen or max(map(len, (self.listen, self.join))) > documents.MAX_LOCATORS:
            raise ConfigurationError(
                f"a router listens at 1 to {documents.MAX_LOCATORS} addresses, and joins as many at most"
            )
        if len(self.hosts) > MAX_HOSTS:
            raise ConfigurationError(f"a router has at most {MAX_HOSTS} names and addresses")
        for locator in (*self.listen, *self.join):
            documents.check_locator(locator)
        for host in self.hosts:
            documents.check_locator(_locator("tls", host, 1))
        for locator in self.join:
            if is_wildcard(documents.check_locator(locator)[1]):
                raise ConfigurationError(
                    f"{locator} is no router to join", "give the address of another router"
                )

    @classmethod
    def read(cls, data: bytes) -> Self:
        keys = frozenset(each.name for each in fields(cls))
        found = documents.read_document(
            data, _ROUTER_SETTINGS_FORM, keys, limit=MAX_SETTINGS_FILE, hint=_ROUTER_SETTINGS_HINT
        )
        if not all(map(documents.is_texts, found.values())):
            raise ConfigurationError(
                f"the {_ROUTER_SETTINGS_FORM} file has a value of another type", _ROUTER_SETTINGS_HINT
            )
        return cls(**{name: tuple(value) for name, value in found.items()})

    def write(self) -> bytes:
        return documents.write_document(_ROUTER_SETTINGS_FORM, asdict(self))

    @property
    def certified(self) -> tuple[str, ...]:
        """What the router's certificate is for: its hosts, where it listens, and this host."""
        addresses = (documents.check_locator(each)[1] for each in self.listen)
        named = (each for each in addresses if not is_wildcard(each))
        return tuple(dict.fromkeys((*self.hosts, *named, *_LOCAL)))

    @property
    def locators(self) -> tuple[str, ...]:
        """Where relays find it, and then the routers that it joins."""
        own = self.own_locators
        if not own:
            raise ConfigurationError(
                "it is not known by which name relays reach this router",
                "say it once: --host router.example.org, or an address",
            )
        return tuple(dict.fromkeys((*own, *self.join)))[: documents.MAX_LOCATORS]

    @property
    def own_locators(self) -> tuple[str, ...]:
        found: list[str] = []
        for each in self.listen:
            protocol, host, port = documents.check_locator(each)
            if is_wildcard(host):
                found += [_locator(protocol, known, port) for known in self.hosts]
            else:
                found.append(each)
        return tuple(found)


class RouterFiles(NamedTuple):
    users: Path
    root_certificate: Path
    key: Path
    certificate: Path


def zenoh_settings(
    settings: RouterSettings, accounts: Accounts | None, files: RouterFiles
) -> dict[str, object]:
    """Paths of Zenoh's configuration with their values; without accounts the router is open to all."""
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
    }
    if any(map(documents.is_encrypted, (*settings.listen, *settings.join))):
        found |= {
            "transport/link/tls/root_ca_certificate": str(files.root_certificate),
            "transport/link/tls/listen_private_key": str(files.key),
            "transport/link/tls/listen_certificate": str(files.certificate),
            "transport/link/tls/verify_name_on_connect": True,
        }
    if accounts is None:
        return {**found, "access_control": open_access_control()}
    # The side that connects is told no user: it knows by the certificate whom it joined (section 4.3), and
    # would otherwise forward nothing.
    plain = [each for each in settings.join if not documents.is_encrypted(each)]
    if plain:
        raise ConfigurationError(
            f"a router with accounts does not join {plain[0]}: nothing says who answers there",
            "join it by tls/ or quic/",
        )
    # Customers and what they connect as routers are below; their routes are not the routers' own.
    # Else one who connects as a router to two of them, and claims that the way is short, would be sent what
    # they have for each other, which the access control then drops.
    below = [{"modes": ["client", "peer"]}], [{"region_names": [accounts.region], "negated": True}]
    return {
        **found,
        "region_name": accounts.region,
        "gateway": {"south": [{"filters": filters} for filters in below]},
        "access_control": accounts.access_control(),
        "transport/auth/usrpwd/user": ROUTER_USER,
        "transport/auth/usrpwd/password": accounts.router,
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


def _locator(protocol: str, host: str, port: int) -> str:
    return f"{protocol}/[{host}]:{port}" if ":" in host else f"{protocol}/{host}:{port}"
