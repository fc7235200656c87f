"""What to do where ROSSEC_HOME does not have what was asked for.

The commonest mistakes are a variable that is not set in this terminal and a name with a letter too
few. Who is told to make what is missing makes a second authority, or a second node. So what is here
is said first. Read without a check of who wrote it: nothing is decided by it.
"""

import os
import re
from pathlib import Path
from typing import Final

from ca.suggestions import closest
from rossec.environment import DEFAULT_HOME

_NUMBERS: Final = re.compile(r"(?<=[^_-])(?:[_-][0-9]+)+$")  # as ROS makes names anonymous
_SHOWN: Final = 6
_LOOKED_AT: Final = 512  # entries of a directory, which may be anybody's


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
    """The hint where there is no authority in `home`."""
    begin = "rossec ca init DOMAIN"
    if here := nodes_in(home):
        what = f"here are only nodes: {_listed(here)}; run this where the authority is"
        return f"{_elsewhere(home)}{what}, with its ROSSEC_HOME; for a new authority: {begin}"
    return f"{_elsewhere(home)}next: {begin}"


def _elsewhere(home: Path) -> str:
    """Where it may be instead; empty: no sign of another place."""
    try:
        if home == Path(DEFAULT_HOME).expanduser():
            return "ROSSEC_HOME is not set: if it is elsewhere, export ROSSEC_HOME=DIRECTORY; else "
        other = None if home.exists() else closest(home.name, _homes_beside(home))
    except (OSError, RuntimeError):
        return ""
    if other is None:
        return ""
    return f"there is no directory {home}: did you mean {home.with_name(other)}? else "


def _homes_beside(home: Path) -> list[str]:
    """The names of directories beside `home` that have nodes or an authority."""
    found = list[str]()
    with os.scandir(home.parent) as entries:
        for entry, _ in zip(entries, range(_LOOKED_AT), strict=False):
            path = Path(entry.path)
            if (path / "ca" / "ca.pem").exists() or (path / "nodes").is_dir():
                found.append(entry.name)
    return found


def _listed(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
