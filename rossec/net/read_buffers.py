"""Memory that the connections of a loop are read into, one after the other.

What comes whole is opened there; only a connection that waits for the rest of a record has memory of its own.
What lies there was on the wire, never decrypted. Threads share none: a signal handler that itself receives
may run between the read and its use.
"""

import asyncio
from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap
from typing import Final
from weakref import WeakKeyDictionary

_OF_LOOP: Final = 64 * 1024
_loops: Final[WeakKeyDictionary[asyncio.AbstractEventLoop, memoryview]] = WeakKeyDictionary()


def of_loop(loop: asyncio.AbstractEventLoop) -> memoryview:
    found = _loops.get(loop)
    if found is None:
        # Pages of their own that count only once something was read into them.
        found = _loops[loop] = memoryview(mmap(-1, _OF_LOOP, MAP_PRIVATE | MAP_ANONYMOUS))
    return found
