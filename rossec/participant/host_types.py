"""The message types this host knows: .msg files of its packages, and those of ROS Noetic.

A shell. Used when a grant restricts message contents and the program does not send its message
definition: roscpp's subscribers do not, nor do tools that accept any type.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from grants.errors import DefinitionRefused
from grants.filters import layout
from grants.filters.layout import MAX_DEPTH, MAX_TEXT, SEPARATOR, TYPE_NAME
from rossec.errors import MessageError
from rossec.participant.definitions import Definition

MAX_TYPES: Final = 8 * MAX_DEPTH  # types that one type consists of


def known_type(name: str) -> Definition | None:
    """The type `name` of its package in ROS_PACKAGE_PATH, else as in Noetic."""
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
        whole = "\n".join((texts.pop(name), *(_section(*item) for item in texts.items())))
        return Definition(name, layout.parse(name, whole).md5, whole)
    except (MessageError, DefinitionRefused):
        return None


def _text(name: str) -> str:
    """The definition of `name` alone; a local package may use standard types."""
    found = _read(name)
    if found is None:
        from rossec.participant.message_types import message_type  # noqa: PLC0415 - 15 MB, rarely needed

        found = message_type(name).definition.partition(SEPARATOR)[0]
    return found


def _section(name: str, text: str) -> str:
    return f"{SEPARATOR}\nMSG: {name}\n{text}"


def _read(name: str) -> str | None:
    package, leaf = name.split("/")
    for directory in _directories(package):
        path = directory / "msg" / f"{leaf}.msg"
        try:
            if path.stat().st_size <= MAX_TEXT:
                return path.read_text(errors="replace")  # comments may be in any encoding
        except OSError:
            continue
    return None


def _directories(package: str) -> Iterator[Path]:
    """The candidate directories: a directory of packages, or the package itself."""
    for directory in os.environ.get("ROS_PACKAGE_PATH", "").split(":"):
        if directory:
            yield Path(directory) / package
            if Path(directory).name == package:
                yield Path(directory)
