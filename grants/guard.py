"""What stands between a publisher and one receiver: expiry, conditions, rate, filters, in order.

Built once per connection from the layout the wire proved and the decision; then called for every
message. What it remembers (a rate, a hysteresis) is the holder's and outlives the connection
(`grants.memory`). It fails closed: what it does not understand is not sent.
"""

from collections.abc import Callable, Hashable, Iterable
from functools import partial
from typing import Final, TypeAlias

from grants.conditions.compile import Condition, compile_condition
from grants.decision import Decision
from grants.errors import GrantError, GrantExpired, MessageRefused, RestrictionMismatch
from grants.filters.codegen import Buffer
from grants.filters.compile import Filter, compile_filter
from grants.filters.hashing import Keys, key_names
from grants.filters.layout import Layout
from grants.memory import Cell, CellName, Memory, RateBucket
from grants.model import FilterRule, Restriction
from grants.validity import moment


class Guard:
    """Treats serialized messages of one type for one receiver.

    Args:
        layout: of the messages; may be None only if no restriction looks into them.
        decision: from `authorize`.
        keys: the publisher's keys for `hash`, 32 bytes each, by name (see `needed_keys`).
        recall: finds what the holder's earlier connections have left; without it the guard
            begins afresh, which is for trials only.

    Attributes:
        memory: of its holder, if it needs one.
        key: equal for guards that treat every message alike: treat once, send to all of them.
            Expiry is not part of it: call `check` for every receiver.

    Raises:
        RestrictionMismatch: a restriction is written for another message type.
        ConditionRefused, FilterRefused: a restriction does not fit the layout, or a key is missing.
        MemoryExhausted: what it must remember has no room.
    """

    def __init__(
        self,
        layout: Layout | None,
        decision: Decision,
        keys: Keys | None = None,
        recall: Callable[[Decision], Memory] | None = None,
    ) -> None:
        for restriction in decision.restrictions:
            check_type("unknown" if layout is None else layout.type_name, restriction)
        self.expires: Final = decision.expires
        self.memory: Memory | None = None
        self._recall = Memory if recall is None else partial(recall, decision)
        self._conditions = _conditions(layout, decision.restrictions)
        self._filters = self._compiled(layout, decision.restrictions, keys or {})
        self._bucket = self._limited(decision.restrictions)
        shape = layout.digest if layout is not None else None
        self.key: Hashable = (self.memory, shape, decision.restrictions)

    def _remembering(self) -> Memory:
        if self.memory is None:
            self.memory = self._recall()
        return self.memory

    def _cell(self, stage: int, name: CellName) -> Cell:
        return self._remembering().cell((stage, *name))

    def _compiled(
        self, layout: Layout | None, restrictions: Iterable[Restriction], keys: Keys
    ) -> tuple[Filter, ...]:
        if layout is None:
            return ()
        return tuple(
            compile_filter(layout, stage.values(), keys, partial(self._cell, number))
            for number, stage in enumerate(_stages(restrictions))
        )

    def _limited(self, restrictions: Iterable[Restriction]) -> RateBucket | None:
        """The tightest of the rates: what it lets through, the others do too."""
        rates = [restriction.rate for restriction in restrictions if restriction.rate is not None]
        return self._remembering().bucket(min(rates)) if rates else None

    def check(self, now: int) -> None:
        """Return if the right still holds at `now`.

        Raises:
            GrantExpired: it does not.
        """
        if now >= self.expires:
            raise GrantExpired(
                f"the grant expired at {moment(self.expires)}", "ask the authority to renew it"
            )

    def ready(self, now: int) -> bool:
        """Whether the rate, if there is one, lets a message through at `now`."""
        if self.memory is None or self._bucket is None:
            return True
        with self.memory.lock:
            return self.memory.ready(self._bucket, now)

    def apply(self, message: Buffer, now: int, mark: object = None) -> list[Buffer] | None:
        """Return `message` in pieces as the receiver may see it, or None if it may not.

        Args:
            message: without its length.
            now: seconds since the epoch.
            mark: is the same object for the same message, on whatever connection of the holder:
                it was judged then, and the rate counts it once. None: a message not seen before.

        Raises:
            MessageRefused: the message does not have its type's layout, or anything unforeseen.
        """
        try:
            return self._treat(message, now, object() if mark is None else mark)
        except GrantError:
            raise
        except Exception as error:
            # Fail closed on our own mistakes too: an exception never lets a message through.
            raise MessageRefused(f"treating a message failed: {type(error).__name__}") from error

    def __call__(self, message: Buffer, now: int) -> list[Buffer] | None:
        """`check`, then `treat`.

        Raises:
            GrantExpired, MessageRefused: as they do.
        """
        self.check(now)
        return self.apply(message, now)

    def _treat(self, message: Buffer, now: int, mark: object) -> list[Buffer] | None:
        for condition in self._conditions:
            if condition(message, now) is not True:
                return None
        if self.memory is None:
            return self._filtered(message)
        with self.memory.lock:
            if self._bucket is not None and not self.memory.take(self._bucket, mark, now):
                return None
            return self._filtered(message)

    def _filtered(self, message: Buffer) -> list[Buffer]:
        pieces: list[Buffer] = [message]
        for rewrite in self._filters:
            pieces = rewrite(pieces[0] if len(pieces) == 1 else b"".join(pieces))
        return pieces


_Stage: TypeAlias = dict[str, FilterRule]


def check_type(name: str, restriction: Restriction) -> None:
    """Return if `restriction` may be applied to messages of the type `name`.

    Raises:
        RestrictionMismatch: it is written for another.
    """
    if restriction.type not in (None, name):
        raise RestrictionMismatch(
            f"the grant is restricted for messages of type {restriction.type}, these are {name}",
            "the right does not hold for another type; ask for a grant for it",
        )


def _conditions(
    layout: Layout | None, restrictions: Iterable[Restriction]
) -> tuple[Condition, ...]:
    """All conditions, each once; a restriction without a type may not look into the message."""
    texts = {
        (text, restriction.type) for restriction in restrictions for text in restriction.conditions
    }
    return tuple(
        compile_condition(None if kind is None else layout, text)
        for text, kind in sorted(texts, key=repr)
    )


def needed_keys(restrictions: Iterable[Restriction]) -> frozenset[str]:
    """The names of the filter keys a guard for `restrictions` must be given."""
    return frozenset().union(*(key_names(restriction.filters) for restriction in restrictions))


def _stages(restrictions: Iterable[Restriction]) -> list[_Stage]:
    """As few passes as possible: rules for the same fields must come one after another.

    Every pass can only take information away, so the order of the passes decides the form of
    the result, never that it reveals more than a single pass would.
    """
    stages: list[_Stage] = []
    for restriction in restrictions:
        _place(stages, {rule.path: rule for rule in restriction.filters})
    return [stage for stage in stages if stage]


def _place(stages: list[_Stage], rules: _Stage) -> None:
    """Into the last stage if the rules fit there, else into a new one."""
    if stages and all(
        stages[-1].get(path) == rule or not any(_overlap(path, other) for other in stages[-1])
        for path, rule in rules.items()
    ):
        stages[-1].update(rules)
    else:
        stages.append(dict(rules))


def _overlap(one: str, other: str) -> bool:
    """Whether one path is the other or lies inside it (`a[*].b` lies inside `a`)."""
    steps, others = (path.replace("[*]", ".*").split(".") for path in (one, other))
    shared = min(len(steps), len(others))
    return steps[:shared] == others[:shared]
