"""The files in a relay's home, and in a router's directory. A shell.

A relay has `overlay.json`, its peers, and `account.json`, its routers. A router has its TLS authority, its
certificate, its accounts and what it was told; the authority's key and the accounts are the operator's, and
the same at all their routers. Files are written under the directory's lock and replaced whole.
"""

import os
import secrets
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from rossec import clock, files
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.host.local_sockets import process_lock
from rossec.overlay import documents, router_settings
from rossec.overlay.documents import OPEN_ACCOUNT, Peer, Peers, Routers, is_encrypted
from rossec.overlay.router_settings import Accounts, RouterFiles, RouterSettings
from rossec.overlay.router_tls import RouterAuthority, Share, key_pem

RELAY_PEERS: Final = "overlay.json"
RELAY_ACCOUNT: Final = "account.json"
_NO_ACCOUNT: Final = (
    "the routers' operator makes one: rossec router accounts add NAME; here: rossec relay account FILE"
)
DIRECTORY: Final = "router"  # below ROSSEC_HOME
AUTHORITY_KEY: Final = "authority.key"
AUTHORITY: Final = "authority.pem"
SETTINGS: Final = "router.json"
ACCOUNTS: Final = "accounts.json"
_LOCK: Final = "router.lock"
_MAX_PEM: Final = 8 * 1024
_PASSWORD: Final = 32  # random bytes


class RelayFiles:
    """The files of the relay whose identity is in `home`."""

    def __init__(self, home: NodeHome) -> None:
        self.home: Final = home
        self._peers = home.path / RELAY_PEERS
        self._account = home.path / RELAY_ACCOUNT
        self._read: tuple[tuple[int, ...], Peers] = (), {}

    def peers(self) -> Peers:
        """The peers as of now; the file is read only when it has changed."""
        version = _version(self._peers)
        if version != self._read[0]:
            self._read = version, self._load()
        return self._read[1]

    def change(self, edit: Callable[[dict[str, Peer]], None]) -> None:
        """Let `edit` change the peers, and write them; raises as `peers`."""
        self._check_enrolled()
        with files.locked_directory(self.home.path):
            found = self._load()
            edit(found)
            files.replace(self._peers, documents.write_peers(documents.checked_peers(found.values())))

    @property
    def has_account(self) -> bool:
        return self._account.exists()

    def routers(self) -> Routers:
        missing = ConfigurationError(f"{self.home.name} has no account at a router", _NO_ACCOUNT)
        return Routers.read(files.read_own(self._account, documents.MAX_ACCOUNT_FILE, missing))

    def keep_account(self, data: bytes) -> Routers:
        """Keep an account file, checked, in place of one of before."""
        self._check_enrolled()
        found = Routers.read(data)
        files.replace(self._account, data)
        return found

    def _check_enrolled(self) -> None:
        if not self.home.path.is_dir():
            raise ConfigurationError(
                f"there is no {self.home.name} here", f"enroll it: rossec node request {self.home.name}"
            )

    def _load(self) -> dict[str, Peer]:
        if not self._peers.exists():
            return {}
        missing = ConfigurationError(f"there is no {self._peers}")
        data = files.read_own(self._peers, documents.MAX_PEERS_FILE, missing)
        return documents.read_peers(data, str(self._peers))


class RouterHome:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.files = RouterFiles(
            users=path / "users",
            root_certificate=path / AUTHORITY,
            key=path / "router.key",
            certificate=path / "router.pem",
        )

    def prepare(self) -> None:
        """Make what a first start needs: the directory, the authority, an empty list of accounts."""
        files.make_private_directory(self.path)
        with files.locked_directory(self.path):
            if not (self.path / AUTHORITY_KEY).exists():
                key = ec.generate_private_key(ec.SECP256R1())
                self.write_authority(RouterAuthority.create(key, now=clock.now(), serial=_serial()))
            if not (self.path / ACCOUNTS).exists():
                files.create(self.path / ACCOUNTS, Accounts(new_password()).write())

    def alone(self) -> AbstractContextManager[None]:
        """One router at a time runs from a directory."""
        busy = ConfigurationError(
            f"another router runs from {self.path}", "end it first, or give another --home"
        )
        return process_lock(self.path / _LOCK, busy)

    def authority(self) -> RouterAuthority:
        key = self._private(AUTHORITY_KEY, _MAX_PEM)
        pem = files.read_own(self.path / AUTHORITY, _MAX_PEM, self._missing(AUTHORITY))
        return RouterAuthority.load(key, pem)

    def write_authority(self, authority: RouterAuthority) -> None:
        # The key last, and with O_EXCL: with it the authority is there, and no other takes its place.
        files.replace(self.path / AUTHORITY, authority.pem, 0o644)
        files.create(self.path / AUTHORITY_KEY, key_pem(authority.key))

    def accounts(self) -> Accounts:
        return Accounts.read(self._private(ACCOUNTS, router_settings.MAX_ACCOUNTS_FILE))

    def change_accounts(self, change: Callable[[Accounts], Accounts]) -> Accounts:
        """Let `change` make other accounts of them, and keep those; a running router takes them over."""
        with files.locked_directory(self.path):
            changed = change(self.accounts())
            files.replace(self.path / ACCOUNTS, changed.write())
        return changed

    def settings(self) -> RouterSettings:
        """What the router was told last; before it was told anything, the defaults."""
        if not (self.path / SETTINGS).exists():
            return RouterSettings()
        missing = self._missing(SETTINGS)
        data = files.read_own(self.path / SETTINGS, router_settings.MAX_SETTINGS_FILE, missing)
        return RouterSettings.read(data)

    def tell(self, **given: tuple[str, ...]) -> RouterSettings:
        """Settings with those that were `given`, not empty, in the place of the old ones; kept."""
        with files.locked_directory(self.path):
            old = self.settings()
            found = replace(old, **{name: each for name, each in given.items() if each})
            if found != old or not (self.path / SETTINGS).exists():
                files.replace(self.path / SETTINGS, found.write())
        return found

    def account_file(self, account: str) -> Routers:
        """What a relay needs for an account; `OPEN_ACCOUNT` is that of everybody, without a password."""
        password = "" if account == OPEN_ACCOUNT else self.accounts().password(account)
        locators = self.settings().locators
        encrypted = any(map(is_encrypted, locators))
        root = self.authority().pem.decode() if encrypted else ""
        return Routers(locators, account, password, root)

    def share(self) -> Share:
        return Share(self.authority(), self.accounts(), self.settings().locators)

    def take(self, share: Share) -> None:
        """Take over what another router shares; what this one has of the same authority gives way."""
        files.make_private_directory(self.path)
        with files.locked_directory(self.path):
            if not (self.path / AUTHORITY_KEY).exists():
                self.write_authority(share.authority)
            # Account files of this one trust its own authority alone: they would end without a word.
            elif self.authority().pem != share.authority.pem:
                raise ConfigurationError(
                    f"{self.path} belongs to routers of another authority",
                    "take the file over into another --home, or remove that directory first",
                )
            files.replace(self.path / ACCOUNTS, share.accounts.write())
        own = self.settings().own_locators
        self.tell(join=tuple(each for each in share.join if each not in own))

    def write_for_zenoh(self, settings: RouterSettings, accounts: Accounts | None) -> None:
        """Bring the files that Zenoh reads up to date: users, and a certificate that is not old."""
        if accounts is not None:
            files.replace(self.files.users, accounts.dictionary())
        authority, hosts, now = self.authority(), settings.certified, clock.now()
        if self.files.key.exists() and self.files.certificate.exists():
            found = files.read(self.files.certificate, _MAX_PEM)
            own = self._private(self.files.key.name, _MAX_PEM)
            if authority.is_current(found, own, hosts, now=now):
                return
        key = ec.generate_private_key(ec.SECP256R1())
        made = authority.issue(key.public_key(), hosts, now=now, serial=_serial())
        files.replace(self.files.key, key_pem(key))
        files.replace(self.files.certificate, made, 0o644)

    def accounts_version(self) -> tuple[int, ...]:
        return _version(self.path / ACCOUNTS)

    def _private(self, name: str, limit: int) -> bytes:
        path = self.path / name
        data = files.read_own(path, limit, self._missing(name))
        # Whoever has an account's password has the account.
        if os.lstat(path).st_mode & 0o077:
            raise ConfigurationError(f"{path} can be read by others", f"chmod 600 {path}")
        return data

    def _missing(self, name: str) -> ConfigurationError:
        return ConfigurationError(
            f"there is no {self.path / name}",
            "this is made by `rossec router accounts add`, or the first start of `rossec router`",
        )


def new_password() -> str:
    """For an account, or for routers: 43 characters."""
    return secrets.token_urlsafe(_PASSWORD)


def _version(path: Path) -> tuple[int, ...]:
    # Another value whenever it is another file.
    try:
        found = path.stat()
    except FileNotFoundError:
        return ()
    return found.st_ino, found.st_mtime_ns, found.st_size


def _serial() -> int:
    # 127 random bits: at most 20 octets with a leading zero (RFC 5280 section 4.1.2.2).
    return secrets.randbits(127) | 1
