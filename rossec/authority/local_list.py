"""The newest lists of an authority on the master's host, read without a delivery.

The authority's modules are imported only if there is one: other masters load neither the database
nor the policy's reader.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rossec.authority.home import AuthorityHome

_RECORD: Final = ("ca.db", "ca.db-wal")

_Stamp = tuple[tuple[int, int, int], ...]


class LocalList:
    """The authority in the ROSSEC_HOME `home`; an intermediate signs no lists.

    `..._if_changed`: nothing, unless the record was written since the last call.
    """

    def __init__(self, home: Path) -> None:
        self._home = home
        self._seen: _Stamp = ()
        self._seen_domains: _Stamp = ()

    def newest(self) -> tuple[bytes, bytes] | None:
        authority = self._authority()
        if authority is None:
            return None
        stamp = self._stamp()  # before reading: later writes are then seen as a change
        found = authority.newest_statement()
        self._seen = stamp  # not set after an error: it is read again
        return found

    def newest_if_changed(self) -> tuple[bytes, bytes] | None:
        return self.newest() if self._stamp() != self._seen else None

    def domains(self) -> bytes:
        authority = self._authority()
        if authority is None:
            return b""
        stamp = self._stamp()
        found = authority.domain_list()
        self._seen_domains = stamp
        return b"" if found is None else found[0]

    def domains_if_changed(self) -> bytes:
        return self.domains() if self._stamp() != self._seen_domains else b""

    def _authority(self) -> "AuthorityHome | None":
        if not (self._home / "ca" / "ca.pem").exists():
            return None
        from rossec.authority.home import AuthorityHome  # noqa: PLC0415 - as above

        found = AuthorityHome.at(self._home)
        return None if found.is_intermediate else found

    def _stamp(self) -> _Stamp:
        files = (self._home / "ca" / name for name in _RECORD)
        found = (file.stat() for file in files if file.exists())
        return tuple((stat.st_ino, stat.st_size, stat.st_mtime_ns) for stat in found if stat.st_size)
