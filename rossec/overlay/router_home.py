"""A router's directory: its TLS authority, its certificate, its seats, what it was told. A shell.

The authority's key and the seats are the operator's, and the same in the directories of all their
routers; the certificate and its key are this router's. Everything secret is 0600 and made with
O_EXCL. What Zenoh reads by itself (`users`) is written again from the seats at each start.
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
from rossec.operation.process_lock import process_lock
from rossec.overlay import router_settings, seats
from rossec.overlay.router_settings import RouterFiles, RouterSettings
from rossec.overlay.router_share import Share
from rossec.overlay.router_tls import RouterAuthority, key_pem
from rossec.overlay.routers import OPEN_SEAT, Routers, is_encrypted
from rossec.overlay.seats import Seats

DIRECTORY: Final = "router"  # below ROSSEC_HOME
AUTHORITY_KEY: Final = "authority.key"
AUTHORITY: Final = "authority.pem"
SETTINGS: Final = "router.json"
SEATS: Final = "seats.json"
_LOCK: Final = "router.lock"
_MAX_PEM: Final = 8 * 1024
_PASSWORD: Final = 32  # random bytes


class RouterHome:
    """The directory `path`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files = RouterFiles(
            users=path / "users",
            root_certificate=path / AUTHORITY,
            key=path / "router.key",
            certificate=path / "router.pem",
        )

    def prepare(self) -> None:
        """Make what a first start needs: the directory, the authority, an empty list of seats.

        Raises:
            ConfigurationError: what is there is damaged.
            PathRefused: others can write there.
        """
        files.make_private_directory(self.path)
        with files.locked_directory(self.path):
            if not (self.path / AUTHORITY_KEY).exists():
                self.write_authority(_new_authority())
            if not (self.path / SEATS).exists():
                files.create(self.path / SEATS, Seats(new_password()).write())

    def alone(self) -> AbstractContextManager[None]:
        """One router at a time runs from a directory."""
        busy = ConfigurationError(
            f"another router runs from {self.path}", "end it first, or give another --home"
        )
        return process_lock(self.path / _LOCK, busy)

    def authority(self) -> RouterAuthority:
        """The TLS authority of the operator's routers.

        Raises:
            ConfigurationError: there is none, or it is damaged, or others can read its key.
        """
        key = self._private(AUTHORITY_KEY, _MAX_PEM)
        pem = files.read_own(self.path / AUTHORITY, _MAX_PEM, self._missing(AUTHORITY))
        return RouterAuthority.load(key, pem)

    def write_authority(self, authority: RouterAuthority) -> None:
        """Keep a first authority. Its key is written last: without it nothing was made."""
        files.replace(self.path / AUTHORITY, authority.pem, 0o644)
        files.create(self.path / AUTHORITY_KEY, key_pem(authority.key))

    def seats(self) -> Seats:
        """The seats as of now.

        Raises:
            ConfigurationError: there is no such file, it is damaged, or others can read it.
        """
        return Seats.read(self._private(SEATS, seats.MAX_FILE))

    def change_seats(self, change: Callable[[Seats], Seats]) -> Seats:
        """Let `change` make other seats of them, and keep those; a running router takes them over.

        Raises:
            ConfigurationError: as for `seats`, or what `change` raises.
        """
        with files.locked_directory(self.path):
            changed = change(self.seats())
            files.replace(self.path / SEATS, changed.write())
        return changed

    def settings(self) -> RouterSettings:
        """What the router was told last; before it was told anything, the defaults.

        Raises:
            ConfigurationError: the file is damaged.
        """
        if not (self.path / SETTINGS).exists():
            return RouterSettings()
        missing = self._missing(SETTINGS)
        data = files.read_own(self.path / SETTINGS, router_settings.MAX_FILE, missing)
        return RouterSettings.read(data)

    def tell(self, **given: tuple[str, ...]) -> RouterSettings:
        """Settings with those that were `given`, not empty, in the place of the old ones; kept.

        Raises:
            ConfigurationError: they are not in form, or the file is damaged.
        """
        with files.locked_directory(self.path):
            old = self.settings()
            found = replace(old, **{name: each for name, each in given.items() if each})
            if found != old or not (self.path / SETTINGS).exists():
                files.replace(self.path / SETTINGS, found.write())
        return found

    def seat_file(self, seat: str) -> Routers:
        """What a relay needs for a seat; `OPEN_SEAT` is that of everybody, without a password.

        Raises:
            ConfigurationError: there is no such seat, or no address of this router is known.
        """
        password = "" if seat == OPEN_SEAT else self.seats().password(seat)
        locators = self.settings().locators
        encrypted = any(map(is_encrypted, locators))
        root = self.authority().pem.decode() if encrypted else ""
        return Routers(locators, seat, password, root)

    def share(self) -> Share:
        """What another router of the operator needs.

        Raises:
            ConfigurationError: no address of this router is known, or a file is damaged.
        """
        return Share(self.authority(), self.seats(), self.settings().locators)

    def take(self, share: Share) -> None:
        """Take over what another router shares; what this one has of the same authority gives way.

        Raises:
            ConfigurationError: this router has another authority.
            PathRefused: others can write there.
        """
        files.make_private_directory(self.path)
        with files.locked_directory(self.path):
            if not (self.path / AUTHORITY_KEY).exists():
                self.write_authority(share.authority)
            elif self.authority().pem != share.authority.pem:
                raise ConfigurationError(
                    f"{self.path} belongs to routers of another authority",
                    "take the file over into another --home, or remove that directory first",
                )
            files.replace(self.path / SEATS, share.seats.write())
        own = self.settings().own_locators
        self.tell(join=tuple(each for each in share.join if each not in own))

    def write_for_zenoh(self, settings: RouterSettings, seats_: Seats | None) -> None:
        """Bring the files that Zenoh reads up to date: users, and a certificate that is not old.

        Raises:
            ConfigurationError: the authority is damaged, or not valid now.
        """
        if seats_ is not None:
            files.replace(self.files.users, seats_.dictionary())
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

    def seats_version(self) -> tuple[int, ...]:
        """Another value whenever the file of seats is another one."""
        found = (self.path / SEATS).stat()
        return found.st_ino, found.st_mtime_ns, found.st_size

    def _private(self, name: str, limit: int) -> bytes:
        path = self.path / name
        data = files.read_own(path, limit, self._missing(name))
        if os.lstat(path).st_mode & 0o077:
            raise ConfigurationError(f"{path} can be read by others", f"chmod 600 {path}")
        return data

    def _missing(self, name: str) -> ConfigurationError:
        return ConfigurationError(
            f"there is no {self.path / name}",
            "this is made by `rossec router seats add`, or the first start of `rossec router`",
        )


def new_password() -> str:
    """For a seat, or for routers: 43 characters."""
    return secrets.token_urlsafe(_PASSWORD)


def _new_authority() -> RouterAuthority:
    key = ec.generate_private_key(ec.SECP256R1())
    return RouterAuthority.create(key, now=clock.now(), serial=_serial())


def _serial() -> int:
    """127 random bits: at most 20 octets with a leading zero (RFC 5280 section 4.1.2.2)."""
    return secrets.randbits(127) | 1
