"""The master's configuration file: YAML, a closed schema; every error names its line.

No setting can widen a right. A missing key has its default, and an unknown key is an error: a
misspelt limit must not be ignored.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.master.operation.limits import MasterLimits
from rossec.ros.text import printable

if TYPE_CHECKING:
    from grants.policy.source import Part, YamlScalar

_SIZE: Final = 64 * 1024
_DEPTH: Final = 6
_EVENTS: Final = 1000
_MOST: Final = 1 << 30
_LOGS: Final = ("text", "json")
_PORT: Final = "a number from 0 to 65535, without quotes"
_SWITCH: Final = "true or false (YAML 1.2: yes and on are texts)"
_EXPECTED: Final = {
    "port": _PORT, "metrics": _PORT, "log": "text or json", "audit": _SWITCH, "admin": _SWITCH,
    "announce": _SWITCH, "complaints": "the path of a file",
}  # fmt: skip


@dataclass(frozen=True)
class Config:
    """The settings of `rossec master`.

    Args:
        port: to listen on; None: that of ROS_MASTER_URI.
        log: `text` or `json`.
        audit: write the audit file.
        admin: open the local port of an administrator.
        announce: announce the master on the local links.
        metrics: port for Prometheus, on loopback; None: none.
        complaints: file of the denial log; None: none.
        limits: see `rossec.master.operation.limits`.
        federation: a part of the file for `rossec.federation.config`; None: there is none.
    """

    port: int | None = None
    log: str = "text"
    audit: bool = True
    admin: bool = False
    announce: bool = False
    metrics: int | None = None
    complaints: Path | None = None
    limits: MasterLimits = field(default_factory=MasterLimits)
    federation: "Part | None" = None


def load(path: Path) -> Config:
    """Read a configuration file.

    Raises:
        ConfigurationError: no file, not YAML, or something in it is not allowed.
    """
    data = files.read_own(path, _SIZE, ConfigurationError(f"there is no {path}"), link=True)
    return parse(data.decode(errors="replace"), str(path))


def parse(text: str, name: str) -> Config:
    """Read the text of a configuration file called `name`.

    Raises:
        ConfigurationError: see `load`.
    """
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
    from grants.policy.mistakes import Mistakes  # noqa: PLC0415 - as above
    from grants.policy.source import read_source  # noqa: PLC0415 - as above
    from grants.yaml_text import Bounds  # noqa: PLC0415 - as above

    mistakes = Mistakes(name)
    try:
        tree = read_source(text, mistakes, Bounds(_SIZE, _DEPTH, _EVENTS))
        mistakes.raise_if_any()
    except PolicyRefused as error:
        first = mistakes.found[0]
        message = printable(first.message)
        raise ConfigurationError(
            f"{name}:{first.line}: {message}", printable(first.hint)
        ) from error
    return tree


def _entries(tree: "Part | None", name: str) -> Iterator[tuple[str, "YamlScalar", "Part"]]:
    """Keys, their positions and values."""
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
    if key == "complaints" and isinstance(value, str) and value and printable(value) == value:
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
