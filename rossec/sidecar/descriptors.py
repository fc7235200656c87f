"""How many descriptors this process may have open: as many as it can get, its program as before.

Every connection of a program needs two here, and the usual soft limit of 1024 is for programs that
use select(2), which this one does not. The program may, so it gets the limit it would have had.
"""

import resource
from contextlib import suppress
from typing import Final, TypeAlias

Limits: TypeAlias = tuple[int, int]
"""The soft and the hard one."""

ENOUGH: Final = 1 << 16
_WHICH: Final = resource.RLIMIT_NOFILE


def raise_limit() -> Limits:
    """Raise the soft limit as far as it goes, at most to `ENOUGH`; returns the limits before."""
    before = resource.getrlimit(_WHICH)
    soft, hard = before
    wanted = ENOUGH if hard == resource.RLIM_INFINITY else min(hard, ENOUGH)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # a container may forbid it: then fewer must do
            resource.setrlimit(_WHICH, (wanted, hard))
    return before


def restore_limit(before: Limits) -> None:
    """In the child: back to what `raise_limit` returned."""
    resource.setrlimit(_WHICH, before)
