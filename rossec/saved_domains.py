"""What a node, or a master, had of foreign domains when it stopped; older lists are refused.

`domains.cose` is the list of foreign domains, `foreign/DOMAIN.cose` the revocation list of one of
them. Processes of one identity share the directory: an older list never replaces a newer one.
"""

from hashlib import sha256
from pathlib import Path
from typing import Final

from ca.certificates import TrustAnchor
from ca.domains.anchors import Anchors
from ca.domains.lists import MAX_LIST as MAX_DOMAINS
from ca.domains.lists import open_domains
from ca.domains.standing import Standing
from ca.errors import HintedError
from ca.names import check_domain
from ca.revocation.state import MAX_LIST, NO_FLOOR, Revocations, open_statement
from rossec import files
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

OWNED: Final = (
    files.Owned(r"domains\.cose", stays=True),
    files.Owned(r"foreign/[a-z0-9_-][a-z0-9._-]{0,199}\.cose", stays=True),
)
LONGEST: Final = 200  # characters of a domain that is the name of a file


class DomainFiles:
    """The files of one directory.

    Args:
        home: of a node, or of a master.
        anchor: its authority.
    """

    def __init__(self, home: NodeHome, anchor: TrustAnchor) -> None:
        self._path = home.path
        self._anchor = anchor

    def load_domains(self) -> bytes | None:
        """The newest list of domains seen, if any."""
        return _read(self._path / "domains.cose", MAX_DOMAINS)

    def save_domains(self, data: bytes) -> None:
        """Store a verified list of domains; durable on return."""
        with files.locked_directory(self._path):
            held = self.load_domains()
            if held is None or self._number(held) <= self._number(data):
                files.replace(self._path / "domains.cose", data)

    def load_foreign(self, domain: str) -> bytes | None:
        """The newest revocation list of a foreign domain seen, if any."""
        return _read(self._foreign(domain), MAX_LIST)

    def save_foreign(self, root: TrustAnchor, data: bytes) -> None:
        """Store a verified revocation list of the domain of `root`; durable on return.

        One of another root of that domain is replaced.
        """
        path = self._foreign(root.domain)
        files.make_private_directory(path.parent)
        with files.locked_directory(self._path):
            held = self.load_foreign(root.domain)
            if held is None or _list_number(held, root) <= _list_number(data, root):
                files.replace(path, data)

    def anchors(self) -> Anchors:
        """The own authority, with the list of domains that was saved.

        Raises:
            DomainsRefused: the list is not the authority's.
            ConfigurationError: it cannot be read.
        """
        anchors, saved = Anchors(self._anchor), self.load_domains()
        if saved is not None:
            anchors.update(saved)
        return anchors

    def standing(self, anchors: Anchors, own: Revocations, now: int) -> Standing:
        """The own list and those of the listed domains that were saved, none of them confirmed.

        Raises:
            ConfigurationError: a file cannot be read.
        """
        standing = Standing(anchors, own)
        self.restore(standing, now)
        return standing

    def restore(self, standing: Standing, now: int) -> None:
        """Load the saved list of each listed domain of which none is held yet; raises likewise."""
        for listed in standing.anchors.all_listed:
            held = standing.foreign(listed.entry.domain)
            saved = None if held is None or held.data else self.load_foreign(listed.entry.domain)
            if saved is not None:
                standing.restore(listed.entry.domain, saved, now)

    def _number(self, data: bytes) -> tuple[int, int]:
        """The number of a list of the own authority; the lowest if it is invalid."""
        try:
            return open_domains(data, self._anchor).number
        except HintedError:
            return NO_FLOOR

    def _foreign(self, domain: str) -> Path:
        name = check_domain(domain)
        if len(name) > LONGEST:
            name = sha256(name.encode()).hexdigest()
        return self._path / "foreign" / f"{name}.cose"


def _list_number(data: bytes, root: TrustAnchor) -> tuple[int, int]:
    try:
        return open_statement(data, root.public_key).number
    except HintedError:
        return NO_FLOOR


def _read(path: Path, limit: int) -> bytes | None:
    missing = ConfigurationError(f"there is no {path.name} in {path.parent}")
    return files.read_own(path, limit, missing) if path.exists() else None
