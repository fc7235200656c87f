"""`federation.json` in a master's home: the sites that `rossec federation add` has given. A shell.

Written under the directory's lock and replaced whole; a running master reads it when it has
changed. Only the master's own user can write there.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.federation.settings import MAX_FILE, SiteSettings, read_sites, write_sites

FILE: Final = "federation.json"


class SiteFile:
    """The file in `directory`, the home of a master."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._path = directory / FILE
        self._read: tuple[tuple[int, ...], dict[str, SiteSettings]] = (), {}

    def sites(self) -> Iterable[SiteSettings]:
        """The sites as of now; the file is read only when it has changed.

        Raises:
            ConfigurationError: it is not of this form.
        """
        version = self._version()
        if version != self._read[0]:
            self._read = version, self._load()
        return tuple(self._read[1].values())

    def change(self, edit: Callable[[dict[str, SiteSettings]], None]) -> None:
        """Let `edit` change the sites, and write them.

        Raises:
            ConfigurationError: the file is not of this form, or there is no such directory.
        """
        if not self._directory.is_dir():
            raise ConfigurationError(
                f"there is no master in {self._directory}",
                "enroll it first, by the name in ROSSEC_MASTER, or run this where the master runs",
            )
        with files.locked_directory(self._directory):
            sites = self._load()
            edit(sites)
            files.replace(self._path, write_sites(sites))

    def _load(self) -> dict[str, SiteSettings]:
        if not self._path.exists():
            return {}
        missing = ConfigurationError(f"there is no {self._path}")
        return read_sites(files.read_own(self._path, MAX_FILE, missing), str(self._path))

    def _version(self) -> tuple[int, ...]:
        try:
            found = self._path.stat()
        except FileNotFoundError:
            return ()
        return found.st_ino, found.st_mtime_ns, found.st_size
