"""From the environment: ROSSEC_HOME, the directory of all files, and names of own services."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from ca.keys import ownership
from ca.names import GATEWAY, MASTER, RELAY, is_gateway, is_master_name, is_relay_name
from rossec.errors import ConfigurationError

DEFAULT_HOME: Final = "~/.local/share/rossec"
OWN_MASTER: Final = "ROSSEC_MASTER"  # the name of a node's own master
OWN_RELAY: Final = "ROSSEC_RELAY"  # the name of the relay of this host
OWN_GATEWAY: Final = "ROSSEC_GATEWAY"  # the name of the gateway of this host


def rossec_home(environ: Mapping[str, str]) -> Path:
    """ROSSEC_HOME, by default `~/.local/share/rossec`.

    Raises:
        ConfigurationError: not an absolute path, or the home directory is unknown.
    """
    value = environ.get("ROSSEC_HOME", DEFAULT_HOME)
    try:
        path = Path(value).expanduser()
    except RuntimeError as error:  # no such user, or one that has no home
        raise ConfigurationError(
            f"{value.partition('/')[0]} is no home directory", "set ROSSEC_HOME to an absolute path"
        ) from error
    if not path.is_absolute():
        raise ConfigurationError(f"ROSSEC_HOME is {value!r}", "give it an absolute path")
    return path


def own_home(environ: Mapping[str, str]) -> Path:
    """`rossec_home`, if only its owner can write there; it need not exist yet.

    Raises:
        ConfigurationError: as for `rossec_home`.
        PathRefused: it belongs to another user, or others can write in it.
    """
    path = rossec_home(environ)
    ownership.check_directory(path)
    return path


def own_master(environ: Mapping[str, str]) -> str:
    """ROSSEC_MASTER, the certified name of a node's own master; by default `/master`.

    Raises:
        ConfigurationError: not the name of a master.
    """
    return _own(environ, OWN_MASTER, MASTER, is_master_name)


def own_relay(environ: Mapping[str, str]) -> str:
    """ROSSEC_RELAY, the certified name of the relay of this host; by default `/relay`.

    Raises:
        ConfigurationError: not the name of a relay.
    """
    return _own(environ, OWN_RELAY, RELAY, is_relay_name)


def own_gateway(environ: Mapping[str, str]) -> str:
    """ROSSEC_GATEWAY, the certified name of the gateway of this host; by default `/gateway`.

    Raises:
        ConfigurationError: not the name of a gateway.
    """
    return _own(environ, OWN_GATEWAY, GATEWAY, is_gateway)


def _own(
    environ: Mapping[str, str], variable: str, first: str, is_one: Callable[[str], bool]
) -> str:
    name = environ.get(variable) or first
    if not is_one(name):
        raise ConfigurationError(
            f"{name!r} is not the name of a {first[1:]}",
            f"{variable} and --name take {first}, or {first}/attic with a word of one's own",
        )
    return name
