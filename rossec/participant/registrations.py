"""What one node, or one program, has registered at the master, to be registered again. Pure.

Programs register once and never again; a master that was restarted would not know them. Refused
registrations are kept as well, for when there is a new grant. Thread-safe: iterations are over a
copy, which is made in one step.
"""

from collections.abc import Iterator, Sequence
from typing import Final

from rossec.participant.caller_names import RELATIVE_NAME

Call = tuple[str, tuple[object, ...]]  # a method of the master, its parameters
MAX_REFUSED: Final = 256  # refused registrations of one program that are kept

UNREGISTERS: Final = {
    "unregisterPublisher": "registerPublisher",
    "unregisterSubscriber": "registerSubscriber",
    "unregisterService": "registerService",
    "unsubscribeParam": "subscribeParam",
}
REGISTERS: Final = frozenset(UNREGISTERS.values())
_ADDRESS: Final = {
    "registerPublisher": 3, "registerSubscriber": 3, "registerService": 2, "subscribeParam": 1,
    "unregisterPublisher": 2, "unregisterSubscriber": 2, "unregisterService": 2,
    "unsubscribeParam": 1,
}  # fmt: skip
"""Index of the address that is registered: of the service, else of the slave API."""


class RegistrationTable:
    """The registrations of one name."""

    def __init__(self) -> None:
        self._calls: dict[tuple[str, str], tuple[object, ...]] = {}
        self._refused: set[tuple[str, str]] = set()

    def __iter__(self) -> Iterator[Call]:
        """The calls that register everything, in the order they were made."""
        return iter([(method, params) for (method, _), params in self._calls.copy().items()])

    def refused(self) -> list[Call]:
        """Those that the master refused."""
        calls = self._calls.copy().items()
        return [(key[0], params) for key, params in calls if key in self._refused]

    def find(self, method: str, name: str) -> tuple[object, ...] | None:
        """The parameters that `name` is registered with by `method`."""
        return self._calls.get((method, name))

    def record(self, method: str, params: Sequence[object], *, refused: bool = False) -> None:
        """Record a call that registers, or unregisters, what it names; others are ignored.

        What was registered with another address stays: a new program may have the old name.
        """
        index = _ADDRESS.get(method)
        if index is None or len(params) <= max(index, RELATIVE_NAME[method]):
            return  # the master refuses it
        registers = UNREGISTERS.get(method, method)
        key = registers, str(params[RELATIVE_NAME[method]])
        if registers == method:
            if refused and key not in self._calls and len(self._refused) >= MAX_REFUSED:
                return
            self._calls[key] = tuple(params)
            (self._refused.add if refused else self._refused.discard)(key)
        elif key in self._calls and self._calls[key][_ADDRESS[registers]] == params[index]:
            del self._calls[key]
            self._refused.discard(key)
