"""The master's configuration file: YAML, a closed schema; every error names its line.

No setting can widen a right. A missing key has its default, and an unknown key is an error: a
misspelt limit must not be ignored. A limit is checked before memory is allocated for the peer.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.master.state.parameters import SIZE_LIMIT
from rossec.master.state.registry import NODES_LIMIT
from rossec.net.limits import UNSHOWN_BODY
from rossec.peer_limits import printable
from rossec.ros.xmlrpc import BODY_LIMIT

if TYPE_CHECKING:
    from grants.policy.source import Part, YamlScalar


@dataclass(frozen=True)
class MasterLimits:
    """The limits; the defaults are for a site of a thousand nodes."""

    body: int = BODY_LIMIT  # bytes of one call, and of one answer
    parameters: int = SIZE_LIMIT  # bytes of all parameters together
    connections_per_identity: int = 32  # open at a time; a node has two, and one for each watched graph
    connections_per_domain: int = 256  # open at a time, of all nodes of one foreign domain
    # of those of one identity or foreign domain, as long as no grant gives its nodes any right here
    connections_without_right: int = 16
    # bytes of one call of such a node, but for calls with signed statements
    body_without_right: int = UNSHOWN_BODY
    nodes_per_identity: int = NODES_LIMIT  # registered at a time; only a wildcard identity can have several
    handshake_seconds: int = 5  # from the first byte of a connection to an authenticated peer
    request_seconds: int = 10  # from the first byte of a call to its last
    idle_seconds: int = 120  # between two calls on one connection; nodes call every ten seconds
    unfinished_per_address: int = 128  # unfinished_per_address, unfinished: handshakes at a time
    unfinished: int = 512


_SIZE: Final = 64 * 1024
_DEPTH: Final = 6
_EVENTS: Final = 1000
_MOST: Final = 1 << 30
_LOGS: Final = ("text", "json")
_PORT: Final = "a number from 0 to 65535, without quotes"
_SWITCH: Final = "true or false (YAML 1.2: yes and on are texts)"
_EXPECTED: Final = {
    "port": _PORT,
    "metrics": _PORT,
    "log": "text or json",
    "audit": _SWITCH,
    "admin": _SWITCH,
    "announce": _SWITCH,
    "denial_log": "the path of a file",
}


@dataclass(frozen=True)
class Config:
    """The settings of `rossec master`."""

    port: int | None = None  # to listen on; None: that of ROS_MASTER_URI
    log: str = "text"  # `text` or `json`
    audit: bool = True  # write the audit file
    admin: bool = False  # open the local port of an administrator
    announce: bool = False  # announce the master on the local links
    metrics: int | None = None  # port for Prometheus, on loopback; None: none
    denial_log: Path | None = None  # file of the denial log; None: none
    # limits, federation: parts of the file; the second is for `rossec.federation.settings`
    limits: MasterLimits = field(default_factory=MasterLimits)
    federation: "Part | None" = None


def load(path: Path) -> Config:
    data = files.read_own(path, _SIZE, ConfigurationError(f"there is no {path}"), link=True)
    return parse(data.decode(errors="replace"), str(path))


def parse(text: str, name: str) -> Config:
    values: dict[str, Any] = {}
    for key, word, part in _entries(_tree(text, name), name):
        where = f"{name}:{word.line}"
        match key:
            case "limits":
                values[key] = _limits(part, where, name)
            case "federation":
                values[key] = part
            case _:
                values[key] = _value(key, part, where)
    return Config(**values)


def _tree(text: str, name: str) -> "Part | None":
    from grants.errors import PolicyRefused  # noqa: PLC0415 - not loaded without a file
    from grants.policy.source import Bounds, Mistakes, read_source  # noqa: PLC0415

    mistakes = Mistakes(name)
    try:
        tree = read_source(text, mistakes, Bounds(_SIZE, _DEPTH, _EVENTS))
        mistakes.raise_if_any()
    except PolicyRefused as error:
        first = mistakes.found[0]
        message = printable(first.message)
        raise ConfigurationError(f"{name}:{first.line}: {message}", printable(first.hint)) from error
    return tree


def _entries(tree: "Part | None", name: str) -> Iterator[tuple[str, "YamlScalar", "Part"]]:
    if tree is None:
        return
    entries = getattr(tree, "entries", None)
    if entries is None:
        raise ConfigurationError(f"{name}: not a map of settings", "for example  port: 11311")
    for key, (word, part) in entries.items():
        yield key, word, part


def _value(key: str, part: "Part", where: str) -> object:
    value = getattr(part, "value", None)
    if key in ("port", "metrics") and _is_number(value, 0, 65535):
        return value
    if key in ("audit", "admin", "announce") and isinstance(value, bool):
        return value
    if key == "log" and value in _LOGS:
        return value
    if key == "denial_log" and isinstance(value, str) and value and printable(value) == value:
        return Path(value)
    known = [f.name for f in dataclasses.fields(Config)]
    if key not in known:
        raise ConfigurationError(f"{where}: there is no setting {key[:40]!r}", ", ".join(known))
    raise ConfigurationError(f"{where}: {key} cannot have this value", _EXPECTED[key])


def _limits(part: "Part", where: str, name: str) -> MasterLimits:
    if getattr(part, "entries", None) is None:
        raise ConfigurationError(f"{where}: limits are a map", "for example  body: 1048576")
    known = [f.name for f in dataclasses.fields(MasterLimits)]
    limits: dict[str, Any] = {}
    for key, word, entry in _entries(part, name):
        line, limits[key] = f"{name}:{word.line}", getattr(entry, "value", None)
        if key not in known:
            raise ConfigurationError(f"{line}: there is no limit {key[:40]!r}", ", ".join(known))
        if not _is_number(limits[key], 1, _MOST):
            raise ConfigurationError(f"{line}: {key} must be a whole number from 1 to {_MOST}")
    return MasterLimits(**limits)


def _is_number(value: object, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
