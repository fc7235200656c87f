"""Fields of a time for conditions: hours, days, in a time zone, with CEL's names and numbering.

Months and days of the year count from 0 as in CEL, `getDate` from 1, Sunday is 0. Time zones come
from the system's database and are loaded when the condition is compiled, never later.
"""

import re
from collections.abc import Callable
from datetime import datetime
from functools import lru_cache
from typing import Final

from grants.errors import ConditionRefused

FIELDS: Final[dict[str, Callable[[datetime], int]]] = {
    "getFullYear": lambda time: time.year,
    "getMonth": lambda time: time.month - 1,
    "getDate": lambda time: time.day,
    "getDayOfMonth": lambda time: time.day - 1,
    "getDayOfWeek": lambda time: time.isoweekday() % 7,
    "getDayOfYear": lambda time: time.timetuple().tm_yday - 1,
    "getHours": lambda time: time.hour,
    "getMinutes": lambda time: time.minute,
    "getSeconds": lambda time: time.second,
}

_ZONE: Final = re.compile(r"[A-Za-z][A-Za-z0-9_+-]*(?:/[A-Za-z0-9_+-]+)*", re.ASCII)
_TIMESTAMP: Final = re.compile(
    r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:Z|[+-]\d\d:\d\d)", re.ASCII
)  # RFC 3339, whole seconds


def clock_field(name: str, zone: str) -> Callable[[int], int]:
    """The function from seconds since the epoch to the field `name` in `zone`.

    Raises:
        ConditionRefused: unknown zone.
    """
    in_zone = _datetime_in(zone)
    field = FIELDS[name]
    return lambda now: field(in_zone(now))


def parse_timestamp(text: str) -> int:
    """Seconds since the epoch of an RFC 3339 time such as `2026-11-20T18:00:00Z`.

    Raises:
        ConditionRefused: not such a time.
    """
    try:
        if _TIMESTAMP.fullmatch(text) is not None:
            return int(datetime.fromisoformat(text).timestamp())
    except (ValueError, OverflowError):
        pass
    raise ConditionRefused(f"not a time: {text[:40]!r}", "for example 2026-11-20T18:00:00Z")


@lru_cache(maxsize=64)
def _datetime_in(zone: str) -> Callable[[int], datetime]:
    """Local time in a zone; the last second is cached, since most messages share it."""
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError  # noqa: PLC0415 - 0.3 MB, few conditions need it

    # A name outside the database must not be used as a path.
    matched = _ZONE.fullmatch(zone)
    try:
        info = ZoneInfo(zone if matched is not None else "")
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ConditionRefused(
            f"unknown time zone {zone[:40]!r}", "for example Europe/Zurich or UTC"
        ) from None
    return lru_cache(maxsize=1)(lambda now: datetime.fromtimestamp(now, info))
