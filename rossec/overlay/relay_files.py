"""The files in a relay's home: `overlay.json`, its peers, and `seat.json`, its routers. A shell.

Both are for the relay's user alone (0600): a mailbox is told only in a card, and whoever has the
seat's password has the seat. They are written under the directory's lock and replaced whole; a
running relay reads the peers again when they have changed.
"""

from collections.abc import Callable
from typing import Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.overlay import peers as peer_lists
from rossec.overlay import routers
from rossec.overlay.peers import Peer, Peers
from rossec.overlay.routers import Routers

PEERS: Final = "overlay.json"
SEAT: Final = "seat.json"
_NO_SEAT: Final = (
    "the routers' operator makes one: rossec router seats add NAME; here: rossec relay seat FILE"
)


class RelayFiles:
    """The files of the relay whose identity is in `home`."""

    def __init__(self, home: NodeHome) -> None:
        self.home: Final = home
        self._peers = home.path / PEERS
        self._seat = home.path / SEAT
        self._read: tuple[tuple[int, ...], Peers] = (), {}

    def peers(self) -> Peers:
        """The peers as of now; the file is read only when it has changed.

        Raises:
            ConfigurationError: it is not of this form.
            PathRefused: others could have written it.
        """
        version = self._version()
        if version != self._read[0]:
            self._read = version, self._load()
        return self._read[1]

    def change(self, edit: Callable[[dict[str, Peer]], None]) -> None:
        """Let `edit` change the peers, and write them; raises as `peers`."""
        self._check_enrolled()
        with files.locked_directory(self.home.path):
            found = self._load()
            edit(found)
            files.replace(
                self._peers, peer_lists.write_peers(peer_lists.checked_peers(found.values()))
            )

    @property
    def has_seat(self) -> bool:
        """Whether a seat file is kept."""
        return self._seat.exists()

    def routers(self) -> Routers:
        """The routers, and the seat there.

        Raises:
            ConfigurationError: there is no seat file, or it is not one.
            PathRefused: others could have written it.
        """
        missing = ConfigurationError(f"{self.home.name} has no seat at a router", _NO_SEAT)
        return Routers.read(files.read_own(self._seat, routers.MAX_FILE, missing))

    def keep_seat(self, data: bytes) -> Routers:
        """Keep a seat file, checked, in place of one of before.

        Raises:
            ConfigurationError: it is not one, or the relay is not enrolled.
        """
        self._check_enrolled()
        found = Routers.read(data)
        files.replace(self._seat, data)
        return found

    def _check_enrolled(self) -> None:
        if not self.home.path.is_dir():
            raise ConfigurationError(
                f"there is no {self.home.name} here",
                f"enroll it: rossec node request {self.home.name}",
            )

    def _load(self) -> dict[str, Peer]:
        if not self._peers.exists():
            return {}
        missing = ConfigurationError(f"there is no {self._peers}")
        data = files.read_own(self._peers, peer_lists.MAX_FILE, missing)
        return peer_lists.read_peers(data, str(self._peers))

    def _version(self) -> tuple[int, ...]:
        try:
            found = self._peers.stat()
        except FileNotFoundError:
            return ()
        return found.st_ino, found.st_mtime_ns, found.st_size
