"""What all identities of one border router share, so that a resting thing costs little.

The trust anchor, the lists of domains and of revocations, limits and tasks are equal for all of
them, and are held once. What belongs to one thing is its key, its certificate and its grants.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from ca.certificates import Identity
from ca.domains.standing import Standing
from rossec.channel.edhoc.suites import PRODUCTION
from rossec.net.aio.tasks import TaskSet
from rossec.net.halfopen import HalfOpen, HalfOpenCount
from rossec.ros.names import MASTER
from rossec.ros.settings import Settings

HALF_OPEN: Final = HalfOpen(512, 1024)  # of all ports: the master connects to each thing's node
AT_A_TIME: Final = 8  # things that connect to the master at the same time


@dataclass(frozen=True, eq=False)
class SharedIdentity:
    """What is equal for all identities of this process.

    Attributes:
        standing: whose peers count, and what was revoked; kept current by the border router's node.
        settings: where the master is, and how peers reach this host.
        take_push: takes what the master pushes to any of the identities.
        held_list: the signed revocation list.
        persist: stores a revocation list, durably.
        master: the certified name of the master.
        turns: bounds how many of them connect to the master at a time.
        tasks: of all of them; each ends soon.
    """

    standing: Standing
    settings: Settings
    take_push: Callable[[str, tuple[object, ...], Identity], None]
    held_list: Callable[[], bytes]
    persist: Callable[[bytes], None]
    master: str = MASTER
    suites: tuple[int, ...] = PRODUCTION
    turns: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(AT_A_TIME))
    half_open: HalfOpenCount = field(default_factory=lambda: HalfOpenCount(HALF_OPEN))
    tasks: TaskSet = field(default_factory=TaskSet)
