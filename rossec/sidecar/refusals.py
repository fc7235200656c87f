"""Faults that a program may not print: rosnode says "killed" whatever a node answers.

A program asks for much at its start. What no rule gives it is collected for a second and logged as
one line, which says what rule is missing; the same is not logged again within an hour. What a
client library asks for by itself is no warning: the program works without it (`grants.basics`).
Of a peer that is out of reach the program sees a closed connection, and tries again in silence.
"""

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Final, Generic, TypeVar

from grants.basics import is_dispensable
from grants.missing_rights import MissingRight, missing_right, refusal
from rossec import clock
from rossec.errors import PeerUnreachable
from rossec.participant.silent_answers import nothing_shown, shows_nothing, unheard_refusal
from rossec.ros.text import printable

T = TypeVar("T")
_log = logging.getLogger("rossec.sidecar")
_PREFIX = "rossec: "
_WHERE: Final = "is ROS_IP or ROS_HOSTNAME right on its side, and its name known on this host?"
COLLECTED_FOR: Final = 1.0  # seconds
SAID_FOR: Final = 3600.0
_REMEMBERED: Final = 1024
_LINE: Final = 2000  # characters


class Said(Generic[T]):
    """What was said within the last hour. Pure.

    Args:
        now: seconds, of a clock that only goes forward.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._said: OrderedDict[T, float] = OrderedDict()

    def add(self, what: T) -> bool:
        """Whether it is new."""
        now = self._now()
        if now - self._said.get(what, -SAID_FOR) < SAID_FOR:
            return False
        self._said[what] = now
        self._said.move_to_end(what)
        if len(self._said) > _REMEMBERED:
            self._said.popitem(last=False)
        return True


class MissingRights:
    """What the programs of one identity asked for and no grant gives. Pure.

    Args:
        now: seconds, of a clock that only goes forward.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._said = Said[MissingRight](now)
        self._new: list[MissingRight] = []

    def add(self, missing: MissingRight) -> bool:
        """Whether this is new, and `take` will tell it."""
        if is_dispensable(missing.right, missing.own):
            return False
        if not self._said.add(missing):
            return False
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
        self._reasons, self._paths = Said[str](clock.counter()), Said[str](clock.counter())
        self._timer: asyncio.TimerHandle | None = None

    def log(self, refuser: str, method: str, answer: object, params: Sequence[object] = ()) -> None:
        """Warn of an answer in which rossec refuses a call, or that does not reach the program.

        Of any other: nothing. `params`: of the call.
        """
        match answer:
            case [code, str(status), *_] if code != 1 and status.startswith(_PREFIX):
                missing = missing_right(status)
                if missing is None:
                    self._refused(refuser, method, status.removeprefix(_PREFIX))
                elif self._missing.add(missing) and self._timer is None:
                    loop = asyncio.get_running_loop()
                    self._timer = loop.call_later(COLLECTED_FOR, self.flush)
            case _ if (reason := unheard_refusal(method, params, answer)) is not None:
                self._refused(refuser, method, reason)
            case _:
                pass

    def log_own(self, node: str, method: str, answer: object) -> None:
        """Warn of an answer that the sidecar itself gives a program, unless that was said before.

        What the master refused went through `log`.
        """
        match answer:
            case [-1, str(status), *_] if status.startswith(_PREFIX):
                if missing_right(status) is None:
                    self._refused(f"the sidecar of {node}", method, status.removeprefix(_PREFIX))
            case _ if shows_nothing(method, answer):
                text = nothing_shown(node)
                if self._reasons.add(text):
                    _log.warning("%s: %s", method, printable(text))
            case _:
                pass

    def _refused(self, refuser: str, method: str, reason: str) -> None:
        if self._reasons.add(reason):
            _log.warning("%s refuses %s: %s", refuser, method, printable(reason, _LINE))

    def unreachable(self, peer: str, error: PeerUnreachable) -> None:
        """Warn of a peer whose address leads nowhere; one that refuses callers has just ended."""
        if isinstance(error.__cause__, ConnectionRefusedError) or not self._paths.add(peer):
            return
        _log.warning("%s is out of reach: %s (%s)", printable(peer), printable(str(error)), _WHERE)

    def flush(self) -> None:
        """Log what was collected."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for line in self._missing.take():
            _log.warning("%s", printable(line, _LINE))
