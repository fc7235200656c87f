"""The message types this host knows: .msg files of its packages, and those of ROS Noetic. A shell.

The one place that says where types come from: for policies, for every command, and for guards of programs
that do not send their message definition (roscpp's subscribers do not, nor do tools that accept any type).
Packages are looked for along ROS_PACKAGE_PATH, then where Debian and ROS install them.
"""

import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Final

from grants.errors import DefinitionRefused
from grants.filters import layout
from grants.filters.layout import MAX_DEPTH, MAX_TEXT, SEPARATOR, TYPE_NAME
from rossec.errors import MessageError
from rossec.participant.definitions import Definition

MAX_TYPES: Final = 8 * MAX_DEPTH  # types that one type consists of
INSTALLED: Final = ("/opt/ros/noetic/share", "/usr/share")
_DEPTH: Final = 3  # folders between a place and a package, as of the repositories of a workspace
_MOST_FOLDERS: Final = 4096


def known_type(name: str) -> Definition | None:
    """The type `name` of its package on this host, else as in Noetic."""
    if TYPE_NAME.fullmatch(name) is None:
        return None
    texts: dict[str, str] = {}
    pending = [name]
    try:
        while pending:
            current = pending.pop()
            if current not in texts:
                texts[current] = _text(current)
                pending += sorted(layout.dependencies(current, texts[current]))
            if len(texts) > MAX_TYPES:
                return None
        own = texts.pop(name)
        whole = "\n".join((own, *(f"{SEPARATOR}\nMSG: {other}\n{text}" for other, text in texts.items())))
        return Definition(name, layout.parse(name, whole).md5, whole)
    except (MessageError, DefinitionRefused):
        return None


def definition_of(name: str) -> str:
    """The definition text of the type `name`: that by which this host's guards would read it."""
    found = known_type(name)
    return _registered(name) if found is None else found.definition


def layout_of(name: str) -> layout.Layout:
    return layout.parse(name, definition_of(name))


def _registered(name: str) -> str:
    from rossec.participant.message_types import registered_type  # noqa: PLC0415 - 15 MB, rarely needed

    return registered_type(name).definition


def _text(name: str) -> str:
    package, leaf = name.split("/")
    for place in map(Path, places(os.environ)):
        below = () if str(place) in INSTALLED else _below(place).get(package, ())
        for directory in (place / package, *([place] if place.name == package else []), *below):
            path = directory / "msg" / f"{leaf}.msg"
            try:
                if path.stat().st_size <= MAX_TEXT:
                    return path.read_text(errors="replace")  # comments may be in any encoding
            except OSError:
                continue
    return _registered(name).partition(SEPARATOR)[0]


def places(variables: Mapping[str, str]) -> list[str]:
    given = variables.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    return list(dict.fromkeys(place for place in (*given, *INSTALLED) if place))


@lru_cache(maxsize=16)
def _below(place: Path) -> Mapping[str, tuple[Path, ...]]:
    # A package contains none, so the search ends where there is a package.xml. It is made once for each
    # process: guards ask for every connection. What is directly in a place is always found.
    found: dict[str, tuple[Path, ...]] = {}
    pending, seen = [(place, 0)], 0
    while pending and seen < _MOST_FOLDERS:
        folder, depth = pending.pop()
        try:
            with os.scandir(folder) as entries:  # links are not followed: these may lead in circles
                inside = sorted(each.path for each in entries if each.is_dir(follow_symlinks=False))
        except OSError:
            continue
        for inner in (each for each in map(Path, inside) if not each.name.startswith(".")):
            seen += 1
            if depth > 0:
                found[inner.name] = (*found.get(inner.name, ()), inner)
            if depth < _DEPTH and not (inner / "package.xml").exists():
                pending.append((inner, depth + 1))
    return found
