"""The options of `rossec.secure`: its arguments, else the environment, else a file. Pure.

The file is TOML, with a table `[rospy]`: `$ROSSEC_CONFIG`, or `rossec.toml` in ROSSEC_HOME. An
unknown key or an invalid value is refused: a misspelling must not open anything (F13).
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ca.errors import NameRefused
from ca.names import check_name
from rossec.environment import rossec_home
from rossec.errors import ConfigurationError

_DOTS: Final = 2000  # tomllib takes square time and memory for the dots of one key
_KEYS: Final = frozenset({"node", "allow_plain"})


@dataclass(frozen=True)
class Options:
    """How a process is secured.

    Attributes:
        home: ROSSEC_HOME.
        node: the name of the node, absolute or as given to `rospy.init_node`; None: as given
            there.
        allow_plain: what may stay plain while a fleet migrates (`rossec.inprocess.allow_plain`).
    """

    home: Path
    node: str | None = None
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
    """The options from the arguments, the environment and the file's text.

    Raises:
        ConfigurationError: one of them is invalid.
    """
    table = _table(text) if text is not None else {}
    name = _first(node, environ.get("ROSSEC_NODE"), table.get("node"))
    plain = _first(allow_plain, _split(environ.get("ROSSEC_ALLOW_PLAIN")), table.get("allow_plain"))
    return Options(
        rossec_home(environ), _checked_name(name), () if plain is None else _checked_list(plain)
    )


def _table(text: str) -> Mapping[str, object]:
    if text.count(".") > _DOTS:
        raise ConfigurationError(
            f"the options' file has more than {_DOTS} dots", "a table [rospy] of a few lists"
        )
    try:
        table = tomllib.loads(text).get("rospy", {})
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and what `int` refuses
        raise ConfigurationError(f"the options' file is not TOML: {error}") from error
    if not isinstance(table, dict) or not table.keys() <= _KEYS:
        raise ConfigurationError(
            "the table [rospy] of the options' file holds something unknown",
            f"known keys: {', '.join(sorted(_KEYS))}",
        )
    return table


def _first(*values: object) -> object:
    return next((value for value in values if value is not None), None)


def _split(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _checked_name(name: object) -> str | None:
    if name is None:
        return None
    text = str(name)
    try:
        check_name(text if "/" in text else f"/{text}")
    except NameRefused as error:
        raise ConfigurationError(
            f"{name!r} is not the name of a node: {error}", error.hint
        ) from error
    return text


def _checked_list(values: object) -> tuple[str, ...]:
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ConfigurationError("allow_plain is a list of names", 'allow_plain=["/topic"]')
    if not all(isinstance(value, str) and value for value in values):
        raise ConfigurationError("allow_plain holds something that is not text")
    return tuple(values)
