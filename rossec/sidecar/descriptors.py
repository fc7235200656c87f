"""The limit of open descriptors: raised for this process, restored for its program.

Every connection of a program needs two here. The usual soft limit of 1024 is for programs that use
select(2), which this process does not. The program may, so it gets the original limit.
"""

import resource
from contextlib import suppress
from typing import Final, TypeAlias

Limits: TypeAlias = tuple[int, int]
"""The soft and the hard limit."""

ENOUGH: Final = 1 << 16
_WHICH: Final = resource.RLIMIT_NOFILE


def raise_limit() -> Limits:
    """Raise the soft limit as far as allowed, at most to `ENOUGH`; return the previous limits."""
    before = resource.getrlimit(_WHICH)
    soft, hard = before
    wanted = ENOUGH if hard == resource.RLIM_INFINITY else min(hard, ENOUGH)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # a container may forbid it
            resource.setrlimit(_WHICH, (wanted, hard))
    return before


def restore_limit(before: Limits) -> None:
    """In the child: restore what `raise_limit` returned."""
    resource.setrlimit(_WHICH, before)
