"""Memory that sockets are read into, shared by connections that never read at the same time.

A record that is a whole message is opened from there; only a connection that waits for the rest of one has
memory of its own. What lies there is what was on the wire, never what was decrypted.
"""

import asyncio
from mmap import mmap
from typing import Final
from weakref import WeakKeyDictionary

_OF_LOOP: Final = 64 * 1024
_loops: Final[WeakKeyDictionary[asyncio.AbstractEventLoop, memoryview]] = WeakKeyDictionary()


def of_loop(loop: asyncio.AbstractEventLoop) -> memoryview:
    # Of all connections of a loop, which reads them one after the other.
    found = _loops.get(loop)
    if found is None:
        found = _loops[loop] = memoryview(mmap(-1, _OF_LOOP))
    return found
