"""What this host knows of message types: the .msg files its programs were made from, and ROS's own.

A shell. It is asked when a grant restricts what messages may hold, and the program does not say
how it reads them: roscpp's subscribers do not, nor do tools that take any type.
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

_MOST: Final = 8 * MAX_DEPTH  # types that one is made of


def known_type(name: str) -> Definition | None:
    """The type `name` as its package says, found along ROS_PACKAGE_PATH, or as in Noetic's own."""
    if TYPE_NAME.fullmatch(name) is None:
        return None
    texts: dict[str, str] = {}
    waiting = [name]
    try:
        while waiting:
            each = waiting.pop()
            if each not in texts:
                texts[each] = _text(each)
                waiting += sorted(layout.dependencies(each, texts[each]))
            if len(texts) > _MOST:
                return None
        whole = "\n".join((texts.pop(name), *(_part(*item) for item in texts.items())))
        return Definition(name, layout.parse(name, whole).md5, whole)
    except (MessageError, DefinitionRefused):
        return None


def _text(name: str) -> str:
    """The definition of `name` alone; a package of one's own may be made of standard types."""
    found = _read(name)
    if found is None:
        from rossec.participant.message_types import message_type  # noqa: PLC0415 - 15 MB, which few need

        found = message_type(name).definition.partition(SEPARATOR)[0]
    return found


def _part(name: str, text: str) -> str:
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
    """Where the package may be: a directory of packages, or the package itself."""
    for place in os.environ.get("ROS_PACKAGE_PATH", "").split(":"):
        if place:
            yield Path(place) / package
            if Path(place).name == package:
                yield Path(place)
