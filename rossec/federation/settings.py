"""Which masters to follow: from the master's configuration, and from `federation.json` in its home.

A label is given once, and never is that of a foreign domain but where the master is one of it: the
labels of masters of the own domain and of foreign domains name the same thing in `/remote/<label>`.
The part `federation:` of the configuration is a closed schema, with lines in its errors:

    follow_announced: true
    sites:
      kitchen: {uri: http://kitchen:11311, master: /master/kitchen, parameters: [/robot/**]}
      hospital: {uri: http://hospital.example:11311, domain: hospital}
      office: {via: office, master: /master/office}
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from ca.errors import NameRefused
from ca.names import MASTER, check_label, check_pattern, is_master_name
from rossec import files
from rossec.errors import ConfigurationError
from rossec.master.state.imported_facts import Site
from rossec.ros.names import is_loopback, parse_uri

MAX_SITES: Final = 64
MAX_PARAMETERS: Final = 64  # patterns of one site
MAX_FILE: Final = 64 * 1024
_FORM: Final = 1


@dataclass(frozen=True)
class SiteSettings:
    """A master to follow."""

    label: str  # what it is called here
    uri: str  # where it listens; empty: it is reached by a relay
    master: str = MASTER  # the name it is certified for
    domain: str = ""  # the label of its foreign domain; empty: of the own domain
    parameters: tuple[str, ...] = ()  # patterns of those to mirror, with the names they have there
    via: str = ""  # what the relay of this site calls the peer behind which the master is

    def __post_init__(self) -> None:
        try:
            check_label(self.label)
            for label in filter(None, (self.domain, self.via)):
                check_label(label)
            for pattern in self.parameters:
                check_pattern(pattern)
        except NameRefused as error:
            raise ConfigurationError(str(error), error.hint) from error
        if not is_master_name(self.master):
            raise ConfigurationError(
                f"{self.master[:255]!a} is not the name of a master", "/master, or /master/kitchen"
            )
        if len(self.parameters) > MAX_PARAMETERS:
            raise ConfigurationError(f"at most {MAX_PARAMETERS} patterns of parameters for a site")
        if bool(self.via) == bool(self.uri):
            raise ConfigurationError(f"site {self.label} has a URI or a relay's peer, one of them", _WAYS)
        if self.uri:
            parse_uri(self.uri, "the master's URI")

    @property
    def site(self) -> Site:
        return Site(self.label, self.domain, bool(self.via) or is_loopback(self.address[0]))

    @property
    def address(self) -> tuple[str, int]:
        return parse_uri(self.uri, "the master's URI")

    @property
    def place(self) -> str:
        return f"via {self.via}" if self.via else f"at {self.uri}"


def checked_sites(sites: Iterable[SiteSettings]) -> dict[str, SiteSettings]:
    """By label; raises `ConfigurationError` where two are one master, or a label has two meanings."""
    found: dict[str, SiteSettings] = {}
    for each in sites:
        if each.label in found:
            raise ConfigurationError(f"two sites are called {each.label}", "give each its own label")
        for other in found.values():
            if (other.domain, other.master) == (each.domain, each.master):
                raise ConfigurationError(
                    f"{other.label} and {each.label} are one master, {each.master}", "follow it once"
                )
        found[each.label] = each
    domains = {each.domain for each in found.values() if each.domain}
    if twice := sorted({each.label for each in found.values() if not each.domain} & domains):
        raise ConfigurationError(
            f"{twice[0]} is the label of a foreign domain", "give the own master another one"
        )
    if len(found) > MAX_SITES:
        raise ConfigurationError(f"at most {MAX_SITES} sites can be followed")
    return found


def read_sites(data: bytes, name: str) -> dict[str, SiteSettings]:
    if len(data) > MAX_FILE:  # before the parse
        raise ConfigurationError(f"{name} is longer than {MAX_FILE} bytes")
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{name} is not JSON", _HINT) from error
    match found:
        case {"rossec-federation": 1, "sites": list() as rows, **rest} if not rest:
            return checked_sites(_site(row, name) for row in rows)
        case _:
            raise ConfigurationError(f"{name} is not a list of sites of this form", _HINT)


def write_sites(sites: Mapping[str, SiteSettings]) -> bytes:
    rows = [asdict(each) for _, each in sorted(sites.items())]
    rows = [{key: value for key, value in row.items() if value or key != "via"} for row in rows]
    return json.dumps({"rossec-federation": _FORM, "sites": rows}, indent=1).encode() + b"\n"


def _site(row: object, name: str) -> SiteSettings:
    match row:
        case {
            "label": str() as label,
            "uri": str() as uri,
            "master": str() as master,
            "domain": str() as domain,
            "parameters": list() as patterns,
            **rest,
        } if rest.keys() <= {"via"} and isinstance(via := rest.get("via", ""), str):
            texts = tuple(each for each in patterns if isinstance(each, str))
            if len(texts) == len(patterns):
                return SiteSettings(label, uri, master, domain, texts, via)
    raise ConfigurationError(f"{name} has a site that is not in form", _HINT)


_WAYS: Final = "uri: http://kitchen:11311, or via: office, a peer of: rossec relay list"
_HINT: Final = "it is written by `rossec federation add`, `remove` and `param`: use these"

_KEYS: Final = ("follow_announced", "sites")
_SITE_KEYS: Final = ("uri", "master", "domain", "parameters", "via")
_EXAMPLE: Final = "for example  kitchen: {uri: http://kitchen:11311, master: /master/kitchen}"


@dataclass(frozen=True)
class FederationConfig:
    """Which masters to follow."""

    follow_announced: bool = False  # every master of the own domain that is heard on the local links
    sites: tuple[SiteSettings, ...] = ()


def read_config(part: Any, name: str) -> FederationConfig:
    """Read the part, of a file called `name`; None is an empty one."""
    announced, sites = False, tuple[SiteSettings, ...]()
    for key, where, value in _entries(part, name, "federation", _KEYS):
        if key == "sites":
            sites = tuple(
                _config_site(label, entry, line, name) for label, line, entry in _entries(value, name, key)
            )
        else:
            announced = getattr(value, "value", None) is True
            if not isinstance(getattr(value, "value", None), bool):
                raise ConfigurationError(f"{where}: {key} is true or false", "without quotes")
    try:
        checked_sites(sites)
    except ConfigurationError as error:
        raise ConfigurationError(f"{name}: {error}", error.hint) from error
    return FederationConfig(announced, sites)


def _config_site(label: str, part: Any, where: str, name: str) -> SiteSettings:
    values: dict[str, Any] = {}
    for key, line, value in _entries(part, name, f"site {label[:40]}", _SITE_KEYS):
        if key != "parameters":
            values[key] = _text(key, value, line)
            continue
        items = getattr(value, "items", None)
        if not isinstance(items, tuple):
            raise ConfigurationError(f"{line}: parameters is a list of patterns", "[/robot/**]")
        values[key] = tuple(_text("a pattern", item, line) for item in items)
    if not {"uri", "via"} & values.keys():
        raise ConfigurationError(f"{where}: site {label[:40]!a} has no uri and no via", _EXAMPLE)
    try:
        return SiteSettings(label, **{"uri": "", **values})
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}", error.hint) from error


def _text(key: str, part: Any, where: str) -> str:
    value = getattr(part, "value", None)
    if not isinstance(value, str):
        raise ConfigurationError(f"{where}: {key} is a text", _EXAMPLE)
    return value


def _entries(part: Any, name: str, what: str, keys: tuple[str, ...] = ()) -> Iterator[tuple[str, str, Any]]:
    # What `grants.policy.source` read, taken as used: a map has `entries`, a list `items`, a text `value`.
    if part is None:
        return
    entries = getattr(part, "entries", None)
    if entries is None:
        line = f"{name}:{getattr(part, 'line', 0)}"
        raise ConfigurationError(f"{line}: {what} is a map", _EXAMPLE)
    for key, (word, value) in entries.items():
        where = f"{name}:{word.line}"
        if keys and key not in keys:
            raise ConfigurationError(f"{where}: {what} has no {key[:40]!a}", ", ".join(keys))
        yield key, where, value


FILE: Final = "federation.json"


class SiteFile:
    """The file in `directory`, the home of a master."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._path = directory / FILE
        self._read: tuple[tuple[int, ...], dict[str, SiteSettings]] = (), {}

    def sites(self) -> Iterable[SiteSettings]:
        """The sites as of now; the file is read only when it has changed."""
        version = self._version()
        if version != self._read[0]:
            self._read = version, self._load()
        return tuple(self._read[1].values())

    def change(self, edit: Callable[[dict[str, SiteSettings]], None]) -> None:
        if not self._directory.is_dir():
            raise ConfigurationError(
                f"there is no master in {self._directory}",
                "enroll it first, by the name in ROSSEC_MASTER, or run this where the master runs",
            )
        # Read and written under one lock: of two commands at a time neither undoes the other's change.
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
        # It is replaced whole, so another content is another inode, whatever the time says.
        return found.st_ino, found.st_mtime_ns, found.st_size
