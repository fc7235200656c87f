"""Answers kept by the bytes of their calls, for callers that ask the same again. Pure.

Most reads are repeated: programs poll a parameter, a service or a node. Such an answer is a function of
the caller with its rights, of the second, of the tables, and of the call; the row of its method says so
(`Method.kept`). All of it is compared when an answer is found:

- *The rights.* `Caller` is made anew with every second, every list of revocations, every change of what
  is trusted elsewhere, and every grant that is presented or dropped. So the very object must be the same.
- *The tables.* Everything kept is dropped when a version has moved, or the second: the demand too, as a
  read asks other masters.

Nothing is kept whose call had an event: each denial is in the audit. An answer is found under the key of
its own caller alone, so its time tells nothing of what others ask. It may tell that something has changed
within this second; whom that must not be told (rights in slots) nothing is kept for.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from rossec.master.api.methods import MasterTables
from rossec.master.rights.caller import Caller

MAX_BYTES: Final = 4 * 1024 * 1024  # of all callers
MAX_BYTES_OF_CALLER: Final = 256 * 1024  # the graph of a thousand nodes has its place
_OVERHEAD: Final = 256  # bytes of an entry beside call and answer, about

_Versions: TypeAlias = tuple[int, ...]
CallerNow: TypeAlias = Callable[[], tuple[Caller, int]]


@dataclass(slots=True)
class _Kept:
    caller: Caller
    answers: dict[bytes, bytes] = field(default_factory=dict)
    size: int = 0


class KeptAnswers:
    """The answers of this second."""

    def __init__(self, tables: MasterTables) -> None:
        self._tables = tables
        self._by_key: dict[bytes, _Kept] = {}
        self._size = 0
        self._versions: _Versions = ()

    def __len__(self) -> int:
        return sum(len(kept.answers) for kept in self._by_key.values())

    def find(self, key: bytes, call: bytes, caller_now: CallerNow) -> bytes | None:
        """The answer to a call of the peer with this key; `caller_now` is asked only if one is kept."""
        kept = self._by_key.get(key)
        if kept is None or (answer := kept.answers.get(call)) is None:
            return None
        caller, now = caller_now()
        if self._versions != self._versions_at(now):
            self._drop_all()
        return answer if self._by_key.get(key) is kept and kept.caller is caller else None

    def keep(self, caller: Caller, now: int, call: bytes, answer: bytes) -> None:
        """Keep the answer that `caller` was given at `now`, if there is room."""
        # The authority's own node and the own masters are made anew for each call.
        if caller.has_slots or caller.is_authority or caller.is_own_master:
            return
        versions = self._versions_at(now)
        if self._versions != versions:
            self._drop_all()
            self._versions = versions
        kept = self._by_key.get(caller.thumbprint)
        if kept is None or kept.caller is not caller:
            self._size -= 0 if kept is None else kept.size
            kept = self._by_key[caller.thumbprint] = _Kept(caller)
        size = len(call) + len(answer) + _OVERHEAD
        if kept.size + size > MAX_BYTES_OF_CALLER or self._size + size > MAX_BYTES or call in kept.answers:
            return
        kept.answers[call] = answer
        kept.size += size
        self._size += size

    def _drop_all(self) -> None:
        self._by_key.clear()
        self._size = 0

    def _versions_at(self, now: int) -> _Versions:
        tables = self._tables
        imports = tables.imports
        return (
            now,
            tables.registry.version,
            imports.version,
            imports.demand.version,
            tables.parameters.version,
            imports.mirrors.version,
            tables.trust.domains.generation,
        )
