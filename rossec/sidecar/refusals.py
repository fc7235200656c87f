"""Refusals that a program may not print: rosnode says "killed" whatever a node answers.

A program asks for much at its start. What no rule gives it is collected for a second and logged as
one line, which says what rule is missing; the same is not logged again within an hour. What a
client library asks for by itself is no warning: the program works without it (`grants.basics`).
"""

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from grants.basics import is_dispensable
from grants.missing_rights import MissingRight, missing_right, refusal
from rossec import clock
from rossec.ros.text import printable

_log = logging.getLogger("rossec.sidecar")
_PREFIX = "rossec: "
COLLECTED_FOR: Final = 1.0  # seconds
SAID_FOR: Final = 3600.0
_REMEMBERED: Final = 1024
_LINE: Final = 2000  # characters


class MissingRights:
    """What the programs of one identity asked for and no grant gives. Pure.

    Args:
        now: seconds, of a clock that only goes forward.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._said: OrderedDict[MissingRight, float] = OrderedDict()
        self._new: list[MissingRight] = []

    def add(self, missing: MissingRight) -> bool:
        """Whether this is new, and `take` will tell it."""
        if is_dispensable(missing.right, missing.own):
            return False
        now = self._now()
        if now - self._said.get(missing, -SAID_FOR) < SAID_FOR:
            return False
        self._said[missing] = now
        self._said.move_to_end(missing)
        if len(self._said) > _REMEMBERED:
            self._said.popitem(last=False)
        self._new.append(missing)
        return True

    def take(self) -> list[str]:
        """One line for each node of what is new since the last call."""
        new, self._new = self._new, []
        nodes: dict[str, list[MissingRight]] = {}
        for each in new:
            nodes.setdefault(each.node, []).append(each)
        return [
            refusal(node, [(each.right, each.in_rule) for each in found])
            for node, found in nodes.items()
        ]


class RefusalLog:
    """Logs refusals, in a loop. A shell."""

    def __init__(self) -> None:
        self._missing = MissingRights(clock.counter())
        self._timer: asyncio.TimerHandle | None = None

    def log(self, refuser: str, method: str, answer: object) -> None:
        """Warn of an answer in which rossec refuses a call; of any other: nothing."""
        match answer:
            case [code, str(status), *_] if code != 1 and status.startswith(_PREFIX):
                missing = missing_right(status)
                if missing is None:
                    reason = printable(status.removeprefix(_PREFIX))
                    _log.warning("%s refuses %s: %s", refuser, method, reason)
                elif self._missing.add(missing) and self._timer is None:
                    loop = asyncio.get_running_loop()
                    self._timer = loop.call_later(COLLECTED_FOR, self.flush)
            case _:
                pass

    def flush(self) -> None:
        """Log what was collected."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for line in self._missing.take():
            _log.warning("%s", printable(line, _LINE))
