"""What one master wants of its relay: which forwarded ports are open for it, and what to tell it next. Pure.

On a new connection everything is wanted and told anew, as the master may have been started again.
What it then does not want any more is closed when it has told all: an answer without news.
"""

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from ca.errors import NameRefused
from ca.names import check_label, check_name, is_master_name
from rossec.errors import AnswerMalformed
from rossec.master.state.forwarded_ports import AT_ONCE, KINDS, MAX_FORWARDED_PORTS, ForwardedPort, Target
from rossec.master.state.registry import is_connectable

REPORTED_AT_ONCE: Final = AT_ONCE // 2  # a call is limited in size, and has all ways too
_MAX_MASTERS: Final = 64


class Orders(NamedTuple):
    """What an answer asks for."""

    open: tuple[Target, ...]
    close: tuple[Target, ...]
    masters: Mapping[str, str]  # names and URIs of others of the own domain, to be polled too


class WantedPorts:
    def __init__(self) -> None:
        self.seen = 0
        self._held: dict[Target, ForwardedPort] = {}
        self._untold: dict[Target, ForwardedPort] = {}
        self._failed: dict[Target, None] = {}
        self._old: set[Target] = set()  # held before this connection, and not wanted anew so far

    @property
    def held(self) -> tuple[Target, ...]:
        return tuple(self._held)

    def connected(self) -> None:
        self.seen = 0
        self._untold.clear()
        self._failed.clear()
        self._old = set(self._held)

    def report(self) -> list[list[object]]:
        told = list(self._untold.items())[:REPORTED_AT_ONCE]
        return [[*target, *forwarded_port] for target, forwarded_port in told]

    def take(self, answer: object, reported: int) -> Orders:
        match answer:
            case {
                "version": int() as version,
                "wanted": list() as wanted,
                "unwanted": list() as unwanted,
                "masters": dict() as masters,
                **rest,
            } if not rest:
                pass
            case _:
                raise AnswerMalformed("a master's answer about forwarded ports that is malformed")
        new, gone = [*map(_target, wanted)], [*map(_target, unwanted)]
        others = _masters(masters)
        if len(self._held.keys() | set(new)) > MAX_FORWARDED_PORTS:
            raise AnswerMalformed(f"a master that wants more than {MAX_FORWARDED_PORTS} forwarded ports")
        self.seen = version
        for target in list(self._untold)[:reported]:
            del self._untold[target]
        self._old.difference_update(new)
        if not new and not gone:
            gone, self._old = [*self._old], set()
        for target in gone:
            self._untold.pop(target, None)
            self._failed.pop(target, None)
            self._old.discard(target)
        closed = tuple(target for target in gone if self._held.pop(target, None) is not None)
        return Orders(tuple(dict.fromkeys((*new, *self._failed))), closed, others)

    def opened(self, target: Target, forwarded_port: ForwardedPort) -> None:
        self._held[target] = self._untold[target] = forwarded_port
        self._failed.pop(target, None)

    def failed(self, target: Target) -> bool:
        is_new = target not in self._failed
        self._failed[target] = None
        return is_new

    def lost(self, targets: Iterable[Target]) -> list[Target]:
        found = [target for target in targets if self._held.pop(target, None) is not None]
        for target in found:
            self._untold.pop(target, None)
        return found


def _target(value: object) -> Target:
    match value:
        case [str() as peer, str() as kind, str() as name] if kind in KINDS:
            try:
                return Target(check_label(peer), kind, check_name(name))
            except NameRefused as error:
                raise AnswerMalformed(f"a master that wants a forwarded port of no target: {error}") from None
        case _:
            raise AnswerMalformed("a master that wants a forwarded port of no target")


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
