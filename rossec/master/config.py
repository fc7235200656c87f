"""The master's configuration file: YAML, a closed schema; every error names its line.

Nothing in it can widen a right. What is not written has its default, and a key that does not exist
is an error: a misspelt limit must not be no limit.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from rossec import files
from rossec.errors import ConfigurationError
from rossec.master.limits import Limits
from rossec.ros.text import printable

_SIZE: Final = 64 * 1024
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
    """What `rossec master` does.

    Args:
        port: to listen on; None: that of ROS_MASTER_URI.
        log: `text` or `json`.
        audit: keep the audit file.
        admin: open the local port of an administrator.
        announce: say on the local links where the master is.
        metrics: port of loopback for Prometheus; None: none.
        complaints: file for what nodes lack the right to; None: none.
        limits: see `rossec.master.limits`.
    """

    port: int | None = None
    log: str = "text"
    audit: bool = True
    admin: bool = False
    announce: bool = False
    metrics: int | None = None
    complaints: Path | None = None
    limits: Limits = field(default_factory=Limits)


def load(path: Path) -> Config:
    """Read a configuration file.

    Raises:
        ConfigurationError: no file, not YAML, or something in it is not allowed.
    """
    data = files.read(path, _SIZE, ConfigurationError(f"there is no {path}"))
    return parse(data.decode(errors="replace"), str(path))


def parse(text: str, name: str) -> Config:
    """Read the text of a configuration file called `name`.

    Raises:
        ConfigurationError: see `load`.
    """
    tree = _yaml(text, name)
    values: dict[str, Any] = {}
    for key, value in tree.items():
        where = f"{name}:{_line(tree, key)}"
        if key == "limits":
            values[key] = _limits(value, where, name)
        else:
            values[str(key)] = _value(str(key), value, where)
    return Config(**values)


def _yaml(text: str, name: str) -> Mapping[object, Any]:
    from ruamel.yaml import YAML  # noqa: PLC0415 - a master without a file need not carry it
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415 - as above

    try:
        tree = YAML(typ="rt").load(text)
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{name}:{mark.line + 1}" if mark is not None else name
        problem = printable(getattr(error, "problem", None) or "")
        raise ConfigurationError(f"{where}: not YAML", problem) from error
    except RecursionError as error:
        raise ConfigurationError(f"{name}: nested too deep", "settings are a flat map") from error
    if tree is None:
        return {}
    if not isinstance(tree, Mapping):
        raise ConfigurationError(f"{name}: not a map of settings", "for example  port: 11311")
    return tree


def _line(tree: Any, key: object) -> int:
    return int(tree.lc.key(key)[0]) + 1


def _value(key: str, value: object, where: str) -> object:
    if key in ("port", "metrics") and isinstance(value, int) and _is_number(value, 0, 65535):
        return int(value)  # the reader's own kind of integer is none to getaddrinfo
    if key in ("audit", "admin", "announce") and isinstance(value, bool):
        return value
    if key == "log" and value in _LOGS:
        return str(value)
    if key == "complaints" and isinstance(value, str) and value:
        return Path(value)
    known = [f.name for f in dataclasses.fields(Config)]
    if key not in known:
        raise ConfigurationError(f"{where}: there is no setting {key[:40]!r}", ", ".join(known))
    raise ConfigurationError(f"{where}: {key} cannot have this value", _EXPECTED[key])


def _limits(value: object, where: str, name: str) -> Limits:
    if not isinstance(value, Mapping):
        raise ConfigurationError(f"{where}: limits are a map", "for example  body: 1048576")
    known = [f.name for f in dataclasses.fields(Limits)]
    for key, limit in value.items():
        line = f"{name}:{_line(value, key)}"
        if key not in known:
            raise ConfigurationError(
                f"{line}: there is no limit {str(key)[:40]!r}", ", ".join(known)
            )
        if not _is_number(limit, 1, _MOST):
            raise ConfigurationError(f"{line}: {key} must be a whole number from 1 to {_MOST}")
    return Limits(**{key: int(limit) for key, limit in value.items()})


def _is_number(value: object, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
