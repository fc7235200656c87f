"""From the environment: ROSSEC_HOME, names of own services, and hints where something is missing.

The commonest mistakes are a variable that is not set in this terminal and a name with a letter too
few. Who is told to make what is missing makes a second authority, or a second node. So what is here
is said first. Read without a check of who wrote it: nothing is decided by it.
"""

import os
import re
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import Final

from ca.keys import ownership
from ca.names import GATEWAY, MASTER, RELAY, closest, is_gateway, is_master_name, is_relay_name
from rossec.errors import ConfigurationError

DEFAULT_HOME: Final = "~/.local/share/rossec"
OWN_MASTER: Final = "ROSSEC_MASTER"  # the name of a node's own master
OWN_RELAY: Final = "ROSSEC_RELAY"  # the name of the relay of this host
OWN_GATEWAY: Final = "ROSSEC_GATEWAY"  # the name of the gateway of this host
_NUMBERS: Final = re.compile(r"(?<=[^_-])(?:[_-][0-9]+)+$")  # as ROS makes names anonymous
_SHOWN: Final = 6
_LOOKED_AT: Final = 512  # entries of a directory, which may be anybody's


def rossec_home(environ: Mapping[str, str]) -> Path:
    """ROSSEC_HOME, by default `~/.local/share/rossec`."""
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
    """`rossec_home`, if only its owner can write there; it need not exist yet."""
    path = rossec_home(environ)
    ownership.check_directory(path)
    return path


def own_master(environ: Mapping[str, str]) -> str:
    """ROSSEC_MASTER, the certified name of a node's own master; by default `/master`."""
    return _own(environ, OWN_MASTER, MASTER, is_master_name)


def own_relay(environ: Mapping[str, str]) -> str:
    """ROSSEC_RELAY, the certified name of the relay of this host; by default `/relay`."""
    return _own(environ, OWN_RELAY, RELAY, is_relay_name)


def own_gateway(environ: Mapping[str, str]) -> str:
    """ROSSEC_GATEWAY, the certified name of the gateway of this host; by default `/gateway`."""
    return _own(environ, OWN_GATEWAY, GATEWAY, is_gateway)


def _own(environ: Mapping[str, str], variable: str, first: str, is_one: Callable[[str], bool]) -> str:
    name = environ.get(variable) or first
    if not is_one(name):
        raise ConfigurationError(
            f"{name!r} is not the name of a {first[1:]}",
            f"{variable} and --name take {first}, or {first}/attic with a word of one's own",
        )
    return name


def nodes_in(home: Path) -> list[str]:
    """The names of the nodes that have a key in this home, in order."""
    found = (path.parent.name for path in (home / "nodes").glob("*/node.key"))
    return sorted("/" + each.replace(".", "/") for each in found)


def missing_node(home: Path, name: str) -> str:
    """The hint where the node `name` is not in `home`."""
    request = f"rossec node request {name}"
    base = _NUMBERS.sub("", name)
    if base != name:
        for_all = f"rossec node request {base} --anonymous"
        # Some tools name themselves with a dash, which no certificate has.
        request = for_all if "-" in name else f"{request}, or for all such nodes {for_all}"
    here = nodes_in(home)
    if not here:
        return f"{_elsewhere(home)}next: {request}"
    near = closest(name, here)
    meant = f"did you mean {near}? " if near is not None else _elsewhere(home)
    return f"{meant}here are: {_listed(here)}; for a new node: {request}"


def missing_nodes(home: Path) -> str:
    """The hint where there is no node at all."""
    return f"{_elsewhere(home)}next: rossec node request /NAME"


def missing_authority(home: Path) -> str:
    begin = "rossec ca init DOMAIN"
    if here := nodes_in(home):
        what = f"here are only nodes: {_listed(here)}; run this where the authority is"
        return f"{_elsewhere(home)}{what}, with its ROSSEC_HOME; for a new authority: {begin}"
    return f"{_elsewhere(home)}next: {begin}"


def _elsewhere(home: Path) -> str:
    try:
        if home == Path(DEFAULT_HOME).expanduser():
            return "ROSSEC_HOME is not set: if it is elsewhere, export ROSSEC_HOME=DIRECTORY; else "
        if home.exists():
            return ""
        beside = list[str]()
        with os.scandir(home.parent) as entries:
            for path in (Path(entry.path) for entry in islice(entries, _LOOKED_AT)):
                if (path / "ca" / "ca.pem").exists() or (path / "nodes").is_dir():
                    beside.append(path.name)
    except (OSError, RuntimeError):
        return ""
    other = closest(home.name, beside)
    if other is None:
        return ""
    return f"there is no directory {home}: did you mean {home.with_name(other)}? else "


def _listed(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
