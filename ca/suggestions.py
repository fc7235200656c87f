"""What was probably meant by a value that is not known, or by a name that is refused. Pure.

For hints alone: nothing is decided by it.
"""

import re
import unicodedata
from collections.abc import Iterable
from typing import Final

_SIMILAR: Final = 0.6
_COMPARED: Final = 5000  # values; more would take a second
_MAX: Final = 255  # as `ca.names.MAX_NAME`; of longer ones nothing is proposed
_LETTERS: Final = str.maketrans({"ß": "ss", "æ": "ae", "Æ": "AE", "ø": "o", "Ø": "O", "œ": "oe",
                                 "Œ": "OE", "ł": "l", "Ł": "L", "đ": "d", "Đ": "D"})  # fmt: skip
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")
_NOT_IN_DOMAINS: Final = re.compile(r"[^a-z0-9._-]+")


def closest(value: str, known: Iterable[str]) -> str | None:
    """The known value most like `value`; None: none is like it."""
    values = sorted({str(each) for each in known})[:_COMPARED]
    import difflib  # noqa: PLC0415 - for mistakes alone

    found = difflib.get_close_matches(value, values, 1, _SIMILAR)
    return found[0] if found else None


def proposed_name(text: str) -> str | None:
    """The absolute ROS name most like `text`, which is none: `talker-1` -> `/talker_1`.

    None: there is nothing to keep, or it is private (`~pose`) and has its place elsewhere.
    """
    if len(text) > _MAX or text.startswith("~"):
        return None
    segments = [found for each in _plain(text).split("/") if (found := _segment(each))]
    name = "".join(f"/{each}" for each in segments)
    return name if name and len(name) <= _MAX else None


def proposed_domain(text: str) -> str | None:
    """The trust domain most like `text`, which is none: `My Home` -> `my-home`."""
    if len(text) > _MAX:
        return None
    return _NOT_IN_DOMAINS.sub("-", _plain(text).lower()).strip("-") or None


def _segment(text: str) -> str:
    """A segment of a name: what is not in it becomes `_`, and it begins with a letter."""
    kept = _NOT_IN_NAMES.sub("_", text).strip("_")
    return f"n{kept}" if kept[:1].isdigit() else kept


def _plain(text: str) -> str:
    """Letters without their accents; in ASCII as far as there is such a letter."""
    decomposed = unicodedata.normalize("NFKD", text.translate(_LETTERS))
    return "".join(each for each in decomposed if not unicodedata.combining(each))
