"""The options of `rossec.secure`: its arguments, else the environment, else a file. Pure.

The file is TOML, with a table `[rospy]`: `$ROSSEC_CONFIG`, or `rossec.toml` in ROSSEC_HOME.
"""

import ipaddress
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ca.errors import NameRefused
from ca.names import check_name
from rossec.environment import rossec_home
from rossec.errors import ConfigurationError
from rossec.host.addresses import is_relayed

_DOTS: Final = 2000  # tomllib takes square time and memory for the dots of one key
_KEYS: Final = frozenset({"node", "allow_plain"})
_HINT = "an entry is a topic's or a service's name, /name or /name@address"


@dataclass(frozen=True)
class Options:
    home: Path
    node: str | None = None  # absolute, or as given to `rospy.init_node`; None: as given there
    allow_plain: tuple[str, ...] = ()


def file_of(environ: Mapping[str, str]) -> Path:
    """Where the options' file is, if there is one."""
    named = environ.get("ROSSEC_CONFIG")
    return Path(named) if named is not None else rossec_home(environ) / "rossec.toml"


def read(
    environ: Mapping[str, str],
    text: str | None,
    *,
    node: str | None = None,
    allow_plain: Sequence[str] | None = None,
) -> Options:
    """From arguments, the environment, and then a TOML file; raises `ConfigurationError`."""
    table = _table(text) if text is not None else {}
    name = _first(node, environ.get("ROSSEC_NODE"), table.get("node"))
    if name is not None:
        try:
            check_name(str(name) if "/" in str(name) else f"/{name}")
        except NameRefused as error:
            raise ConfigurationError(f"{name!r} is not the name of a node: {error}", error.hint) from error
    listed = environ.get("ROSSEC_ALLOW_PLAIN")
    split = None if listed is None else [part.strip() for part in listed.split(",") if part.strip()]
    plain = _first(allow_plain, split, table.get("allow_plain"), ())
    if isinstance(plain, str) or not isinstance(plain, Sequence):
        raise ConfigurationError("allow_plain is a list of names", 'allow_plain=["/topic"]')
    if not all(isinstance(value, str) and value for value in plain):
        raise ConfigurationError("allow_plain holds something that is not text")
    return Options(rossec_home(environ), None if name is None else str(name), tuple(plain))


def _table(text: str) -> Mapping[str, object]:
    if text.count(".") > _DOTS:
        raise ConfigurationError(
            f"the options' file has more than {_DOTS} dots", "a table [rospy] of a few lists"
        )
    try:
        table = tomllib.loads(text).get("rospy", {})
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and what `int` refuses
        raise ConfigurationError(f"the options' file is not TOML: {error}") from error
    # A misspelling must not open anything (F13).
    if not isinstance(table, dict) or not table.keys() <= _KEYS:
        raise ConfigurationError(
            "the table [rospy] of the options' file holds something unknown",
            f"known keys: {', '.join(sorted(_KEYS))}",
        )
    return table


def _first(*values: object) -> object:
    return next((value for value in values if value is not None), None)


class PlainConnection:
    """A connection that `allow_plain` names: not authorized, and without an expiry."""

    guard = None
    ends = float("inf")


class PlainPeers:
    """What may stay plain while a fleet migrates: named topics and services, nothing else.

    An entry is a name (`/chatter`), for any peer, or a name and an address, for one
    (`/chatter@192.168.1.7`). A plain connection is neither encrypted nor authenticated.
    """

    def __init__(self, entries: Iterable[str] = ()) -> None:
        self.entries = tuple(entries)
        self._allowed = frozenset(map(_parse, self.entries))

    def __bool__(self) -> bool:
        return bool(self._allowed)

    def allows(self, name: str, address: str) -> bool:
        if is_relayed(address):  # behind that loopback address is anyone
            return False
        return (name, None) in self._allowed or (name, _canonical(address)) in self._allowed


def _parse(entry: str) -> tuple[str, str | None]:
    name, mark, address = entry.partition("@")
    try:
        return check_name(name), _canonical(address) if mark else None
    except (NameRefused, ValueError) as error:
        raise ConfigurationError(f"allow_plain holds {entry!r}: {error}", _HINT) from error


def _canonical(address: str) -> str:
    parsed = ipaddress.ip_address(address)
    mapped = parsed.ipv4_mapped if isinstance(parsed, ipaddress.IPv6Address) else None
    return str(mapped or parsed)
