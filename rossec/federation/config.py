"""The part `federation:` of the master's configuration file: a closed schema, errors with lines.

federation:
  follow_announced: true
  sites:
    kitchen: {uri: http://kitchen:11311, master: /master/kitchen, parameters: [/robot/**]}
    hospital: {uri: http://hospital.example:11311, domain: hospital}
    office: {via: office, master: /master/office}
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from rossec.errors import ConfigurationError
from rossec.federation.settings import SiteSettings, checked_sites

_KEYS: Final = ("follow_announced", "sites")
_SITE_KEYS: Final = ("uri", "master", "domain", "parameters", "via")
_EXAMPLE: Final = "for example  kitchen: {uri: http://kitchen:11311, master: /master/kitchen}"


@dataclass(frozen=True)
class FederationConfig:
    """Which masters to follow.

    Args:
        follow_announced: every master of the own domain that is heard on the local links.
        sites: these.
    """

    follow_announced: bool = False
    sites: tuple[SiteSettings, ...] = ()


def read_config(part: Any, name: str) -> FederationConfig:
    """Read the part, of a file called `name`; None is an empty one.

    Raises:
        ConfigurationError: something in it is not allowed.
    """
    announced, sites = False, tuple[SiteSettings, ...]()
    for key, where, value in _entries(part, name, "federation", _KEYS):
        if key == "sites":
            sites = tuple(
                _site(label, entry, line, name) for label, line, entry in _entries(value, name, key)
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


def _site(label: str, part: Any, where: str, name: str) -> SiteSettings:
    values: dict[str, Any] = {}
    for key, line, value in _entries(part, name, f"site {label[:40]}", _SITE_KEYS):
        values[key] = _patterns(value, line) if key == "parameters" else _text(key, value, line)
    if not {"uri", "via"} & values.keys():
        raise ConfigurationError(f"{where}: site {label[:40]!a} has no uri and no via", _EXAMPLE)
    try:
        return SiteSettings(label, **{"uri": "", **values})
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}", error.hint) from error


def _patterns(part: Any, where: str) -> tuple[str, ...]:
    items = getattr(part, "items", None)
    if not isinstance(items, tuple):
        raise ConfigurationError(f"{where}: parameters is a list of patterns", "[/robot/**]")
    return tuple(_text("a pattern", item, where) for item in items)


def _text(key: str, part: Any, where: str) -> str:
    value = getattr(part, "value", None)
    if not isinstance(value, str):
        raise ConfigurationError(f"{where}: {key} is a text", _EXAMPLE)
    return value


def _entries(
    part: Any, name: str, what: str, keys: tuple[str, ...] = ()
) -> Iterator[tuple[str, str, Any]]:
    """Keys, where they are, and values; with `keys` no others."""
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
