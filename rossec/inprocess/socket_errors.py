"""Errors of sockets as rospy takes them. No state.

rospy tries a publisher again after ECONNABORTED, a timeout or a network that is gone, and gives it
up after any other error of a socket: after a reset, too. But one that accepts and resets is not
gone, as at the door of a relay while the other site is out of reach.
"""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from ca.errors import HintedError

_ENDED: Final = (errno.ECONNRESET, errno.EPIPE, errno.ENOTCONN)


@contextmanager
def resets() -> Iterator[None]:
    """Raise our errors as `ConnectionResetError`, which rospy handles in an open connection."""
    try:
        yield
    except HintedError as error:
        raise ConnectionResetError(errno.ECONNRESET, f"rossec: {error}") from error


@contextmanager
def tried_again() -> Iterator[None]:
    """Raise a reset while a connection is made as `ConnectionAbortedError`."""
    try:
        yield
    except OSError as error:
        if error.errno not in _ENDED:
            raise
        raise ConnectionAbortedError(errno.ECONNABORTED, str(error)) from error
