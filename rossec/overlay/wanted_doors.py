"""What one master wants of its relay: which doors are open for it, and what to tell it next. Pure.

On a new connection everything is wanted and told anew, as the master may have been started again.
What it then does not want any more is closed when it has told all: an answer without news.
"""

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from ca.domains.aliases import check_label
from ca.errors import NameRefused
from ca.names import check_name, is_master_name
from rossec.errors import AnswerMalformed
from rossec.master.state.addresses import is_connectable
from rossec.master.state.doors import AT_ONCE, KINDS, MAX_DOORS, Door, Target

REPORTED_AT_ONCE: Final = AT_ONCE // 2  # a call is limited in size, and has all ways too
_MAX_MASTERS: Final = 64


class Orders(NamedTuple):
    """What an answer asks for.

    Args:
        open, close: targets whose doors are to be opened, and are wanted no longer.
        masters: names and URIs of other masters of the own domain, to be polled too.
    """

    open: tuple[Target, ...]
    close: tuple[Target, ...]
    masters: Mapping[str, str]


class WantedDoors:
    """The targets that a master wants."""

    def __init__(self) -> None:
        self.seen = 0
        self._held: dict[Target, Door] = {}
        self._untold: dict[Target, Door] = {}
        self._failed: dict[Target, None] = {}
        self._old: set[Target] = set()  # held before this connection, and not wanted anew so far

    @property
    def held(self) -> tuple[Target, ...]:
        """The targets that have a door for this master."""
        return tuple(self._held)

    def connected(self) -> None:
        """There is a new connection with the master."""
        self.seen = 0
        self._untold.clear()
        self._failed.clear()
        self._old = set(self._held)

    def report(self) -> list[list[object]]:
        """The doors to tell the master of, a part of them if there are many."""
        told = list(self._untold.items())[:REPORTED_AT_ONCE]
        return [[*target, *door] for target, door in told]

    def take(self, answer: object, reported: int) -> Orders:
        """Take the answer to a call that told of `reported` doors.

        Raises:
            AnswerMalformed: it is invalid, or asks for more doors than there can be.
        """
        match answer:
            case {
                "version": int() as version, "wanted": list() as wanted,
                "unwanted": list() as unwanted, "masters": dict() as masters, **rest,
            } if not rest:  # fmt: skip
                pass
            case _:
                raise AnswerMalformed("a master's answer about doors that is malformed")
        new, gone = [*map(_target, wanted)], [*map(_target, unwanted)]
        others = _masters(masters)
        if len(self._held.keys() | set(new)) > MAX_DOORS:
            raise AnswerMalformed(f"a master that wants more than {MAX_DOORS} doors")
        self.seen = version
        for target in list(self._untold)[:reported]:
            del self._untold[target]
        self._old.difference_update(new)
        if not new and not gone:
            gone, self._old = [*self._old], set()
        closed = tuple(self._closed(gone))
        return Orders(tuple(dict.fromkeys((*new, *self._failed))), closed, others)

    def opened(self, target: Target, door: Door) -> None:
        """The door of a target is open, from now or from before."""
        self._held[target] = self._untold[target] = door
        self._failed.pop(target, None)

    def failed(self, target: Target) -> bool:
        """No door could be opened: it is tried after each answer. Returns whether this is new."""
        is_new = target not in self._failed
        self._failed[target] = None
        return is_new

    def lost(self, targets: Iterable[Target]) -> list[Target]:
        """These doors were closed; returns those that are wanted, which are to be opened again."""
        found = [target for target in targets if self._held.pop(target, None) is not None]
        for target in found:
            self._untold.pop(target, None)
        return found

    def _closed(self, gone: Iterable[Target]) -> list[Target]:
        for target in gone:
            self._untold.pop(target, None)
            self._failed.pop(target, None)
            self._old.discard(target)
        return [target for target in gone if self._held.pop(target, None) is not None]


def _target(value: object) -> Target:
    match value:
        case [str() as peer, str() as kind, str() as name] if kind in KINDS:
            try:
                return Target(check_label(peer), kind, check_name(name))
            except NameRefused as error:
                raise AnswerMalformed(f"a master that wants a door of no target: {error}") from None
        case _:
            raise AnswerMalformed("a master that wants a door of no target")


def _masters(found: Mapping[object, object]) -> dict[str, str]:
    if len(found) > _MAX_MASTERS:
        raise AnswerMalformed("a master's answer with too many masters")
    masters = {
        name: uri
        for name, uri in found.items()
        if isinstance(name, str) and isinstance(uri, str)
        if is_master_name(name) and is_connectable(uri, "http")
    }
    if len(masters) != len(found):
        raise AnswerMalformed("a master's answer with a master that is not one")
    return masters
