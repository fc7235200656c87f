"""A connection does not survive a fork.

Parent and child would both hold its keys and counters, and seal two different records under one
nonce: with AES-GCM that gives both plaintexts and the authentication key away (RFC 5116, 5.1.1). So
the child forgets what it inherited; the parent's connections go on. `subprocess` and
multiprocessing's `spawn` run no Python between fork and `exec`: programs started so are safe.
"""

import os
from typing import Final, Protocol
from weakref import WeakSet


class Inherited(Protocol):
    """What a forked process must not use."""

    def abandon(self) -> None:
        """Forget keys and counters; send nothing: the connection is the parent's."""


_watched: Final[WeakSet[Inherited]] = WeakSet()


def forget_in_children(inherited: Inherited) -> None:
    """Have every forked child abandon it, before other code of the child runs."""
    _watched.add(inherited)


def _in_child() -> None:
    try:
        for inherited in list(_watched):
            inherited.abandon()
    except BaseException:  # noqa: BLE001 - better no child than one that holds its parent's keys
        os._exit(os.EX_SOFTWARE)


os.register_at_fork(after_in_child=_in_child)
