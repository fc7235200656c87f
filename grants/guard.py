"""The restrictions for one receiver: expiry, conditions, limits, filters, in this order.

Those of narrowings come after, layer by layer: the conditions and filters of one see what the
filters before it left. Else whoever may narrow its right could ask, by conditions of its own, what
the filters hide from it. Conditions that read no message are checked first, whoever wrote them.

Built once per connection from the layout the wire proved and the decision; then called for every
message. Its limits belong to the holder and outlive the connection (`grants.memory`); hysteresis is
common to all holders (`grants.common_state`). It fails closed: what it cannot process is not sent.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator
from functools import partial
from itertools import groupby
from typing import Final, NamedTuple, TypeAlias

from grants.common_state import (
    BodyFields,
    CommonState,
    FieldKey,
    HysteresisState,
    frame_reader,
    group_of,
)
from grants.conditions.compile import Condition, compile_condition
from grants.decision import Decision
from grants.errors import GrantError, GrantExpired, MessageRefused, RestrictionMismatch
from grants.filters.codegen import Buffer
from grants.filters.compile import Filter, compile_filter
from grants.filters.hashing import Keys, is_personal, key_names, receiver_keys
from grants.filters.layout import Layout
from grants.limits import RateBucket, SlotGate
from grants.memory import Memory
from grants.model import KEY_SIZE, FilterRule, Restriction
from grants.validity import format_time


class _Layer(NamedTuple):
    """What one link of a chain adds, or all of the grants: conditions, then filters."""

    conditions: tuple[Condition, ...] = ()
    filters: tuple[Filter, ...] = ()


class Guard:
    """Applies restrictions to serialized messages of one type for one receiver.

    Args:
        layout: of the messages; may be None only if no restriction reads them.
        decision: from `authorize`.
        keys: the publisher's keys for `hash`, 32 bytes each, by name (see `needed_keys`).
        find_memory: finds the state of the holder's earlier connections; without it the guard
            starts with fresh state, which is for trials only.

    Attributes:
        memory: state of the holder, if the guard needs any.
        key: equal for guards with the same result for every message: apply once, send to all.
            Expiry is not part of it: call `check` for every receiver.

    Raises:
        RestrictionMismatch: a restriction is written for another message type.
        ConditionRefused, FilterRefused: a restriction does not fit the layout, or a key is missing.
        MemoryExhausted: there is no room for its state.
    """

    def __init__(
        self,
        layout: Layout | None,
        decision: Decision,
        keys: Keys | None = None,
        find_memory: Callable[[Decision], Memory] | None = None,
    ) -> None:
        for restriction in decision.restrictions:
            check_type("unknown" if layout is None else layout.type_name, restriction)
        self.expires: Final = decision.expires
        self.memory: Memory | None = None
        self._find_memory = Memory if find_memory is None else partial(find_memory, decision)
        self._group = group_of(decision)
        self._common: CommonState | None = None
        self._body: BodyFields | None = None
        header = layout is not None and _begins_with_header(layout)
        self._frame = frame_reader(has_header=header)
        ordered = sorted(decision.restrictions, key=lambda each: each.layer)
        blind = _compile_conditions(None, (each for each in ordered if each.type is None))
        own = receiver_keys(keys or {}, _receiver(decision))
        first, *later = [*self._compile_layers(layout, ordered, own)] or [_Layer()]
        self._conditions = (*blind, *first.conditions)
        self._layers = (first._replace(conditions=()), *later)
        self._bucket = self._rate_bucket(decision.restrictions)
        self._gate = self._slot_gate(decision.restrictions)
        shape = layout.digest if layout is not None else None
        personal = any(is_personal(restriction.filters) for restriction in decision.restrictions)
        receiver = _receiver(decision) if personal else None
        self.key: Hashable = (self.memory, shape, decision.restrictions, receiver)

    def _require_memory(self) -> Memory:
        if self.memory is None:
            self.memory = self._find_memory()
        return self.memory

    def _require_common(self) -> CommonState:
        if self._common is None:
            self._common = self._require_memory().common(self._group)
            if self._group[0]:
                self._body = BodyFields(self._common)
        return self._common

    def _hysteresis(self, stage: int, field: FieldKey) -> HysteresisState:
        common = self._require_common()
        own = (stage, *field)
        return common.hysteresis(own) if self._body is None else self._body.bind(own)

    def _compile_layers(
        self, layout: Layout | None, restrictions: Iterable[Restriction], keys: Keys
    ) -> Iterator[_Layer]:
        """The layers in order; conditions that read no message are not in them."""
        stages_before = 0
        for _, group in groupby(restrictions, key=lambda each: each.layer):
            here = tuple(group)
            stages = [] if layout is None else _stages(here)
            filters = (
                compile_filter(layout, stage.values(), keys, partial(self._hysteresis, number))
                for number, stage in enumerate(stages, stages_before)
                if layout is not None
            )
            stages_before += len(stages)
            typed = (each for each in here if each.type is not None)
            yield _Layer(_compile_conditions(layout, typed), tuple(filters))

    def _rate_bucket(self, restrictions: Iterable[Restriction]) -> RateBucket | None:
        """The lowest of the rates: a message it admits is admitted by the others."""
        rates = [restriction.rate for restriction in restrictions if restriction.rate is not None]
        return self._require_memory().bucket(min(rates)) if rates else None

    def _slot_gate(self, restrictions: Iterable[Restriction]) -> SlotGate | None:
        """The longest of the slots."""
        slots = [restriction.slot for restriction in restrictions if restriction.slot is not None]
        if self._group[0]:
            self._require_common()
        self._slot = max(slots, default=0)
        return self._require_memory().gate(self._slot) if slots else None

    def check(self, now: float) -> None:
        """Return if the right still holds at `now`.

        Raises:
            GrantExpired: it does not.
        """
        if now >= self.expires:
            raise GrantExpired(
                f"the grant expired at {format_time(self.expires)}", "ask the authority to renew it"
            )

    def ready(self, now: float) -> bool:
        """Whether the limits, if there are any, admit a message at `now`."""
        if self.memory is None:
            return True
        with self.memory.lock:
            gate = self._gate
            opened = gate is None or (gate.ready(now) and self.memory.is_longest(gate, now))
            return opened and (self._bucket is None or self._bucket.refill(now))

    def apply(self, message: Buffer, now: float, message_id: object = None) -> list[Buffer] | None:
        """Return `message` in pieces, filtered for the receiver; None if it must not be sent.

        Args:
            message: without its length prefix.
            now: seconds since the epoch; limits count its fractions.
            message_id: the same object for the same message on all connections of the holder, so
                that the rate counts it once. None: a new message.

        Raises:
            MessageRefused: the message does not have its type's layout, or an unexpected error.
        """
        try:
            return self._apply(message, now, object() if message_id is None else message_id)
        except GrantError:
            raise
        except Exception as error:
            # Fail closed on programming errors too: an exception never lets a message through.
            raise MessageRefused(f"applying restrictions failed: {type(error).__name__}") from error

    def __call__(self, message: Buffer, now: float) -> list[Buffer] | None:
        """`check`, then `apply`.

        Raises:
            GrantExpired, MessageRefused: as they do.
        """
        self.check(now)
        return self.apply(message, now)

    def _apply(self, message: Buffer, now: float, message_id: object) -> list[Buffer] | None:
        whole = int(now)  # as conditions see it
        if not all(condition(message, whole) is True for condition in self._conditions):
            return None
        if self.memory is None:
            return self._filter(message, whole)
        with self.memory.lock:
            if not self._admits(self.memory, message, message_id, now):
                return None
            if self._common is None:
                return self._filter(message, whole)
            with self._common.lock:
                return self._filter_in_common(message, whole)

    def _filter_in_common(self, message: Buffer, now: int) -> list[Buffer] | None:
        if self._body is None:
            return self._filter(message, now)
        frame = self._frame(message)
        self._body.load(frame)
        pieces = self._filter(message, now)
        self._body.store(frame)
        return pieces

    def _admits(self, memory: Memory, message: Buffer, message_id: object, now: float) -> bool:
        gate = self._gate
        if gate is not None and not (gate.note(message_id, now) and memory.is_longest(gate, now)):
            return False
        if self._body is not None and not self._leads(message, now):
            return False
        if self._bucket is not None and not memory.take(self._bucket, message_id, now):
            return False
        if gate is not None:
            gate.charge(message_id)
        return True

    def _leads(self, message: Buffer, now: float) -> bool:
        """Whether the body is told in the frame of this message: in two, their cells intersect."""
        with self._require_common().lock:
            return self._require_common().leads(self._frame(message), now, self._slot)

    def _filter(self, message: Buffer, now: int) -> list[Buffer] | None:
        """The message after all layers; None: one that sees the work of another refuses it."""
        pieces: list[Buffer] = [message]
        for layer in self._layers:
            for condition in layer.conditions:
                pieces = [_joined(pieces)]
                if condition(pieces[0], now) is not True:
                    return None
            for rewrite in layer.filters:
                pieces = rewrite(_joined(pieces))
        return pieces


def _begins_with_header(layout: Layout) -> bool:
    fields = layout.root.fields
    return bool(fields) and fields[0][1].name == "std_msgs/Header"


_Stage: TypeAlias = dict[str, FilterRule]


def _receiver(decision: Decision) -> bytes:
    """The key of whoever receives the messages; zeros in a trial, which has no grants."""
    return decision.grants[0].holder if decision.grants else bytes(KEY_SIZE)


def check_type(name: str, restriction: Restriction) -> None:
    """Return if `restriction` may be applied to messages of the type `name`.

    Raises:
        RestrictionMismatch: it is for another type.
    """
    if restriction.type not in (None, name):
        raise RestrictionMismatch(
            f"the grant is restricted for messages of type {restriction.type}, these are {name}",
            "ask for a grant for this message type",
        )


def _joined(pieces: list[Buffer]) -> Buffer:
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def _compile_conditions(
    layout: Layout | None, restrictions: Iterable[Restriction]
) -> tuple[Condition, ...]:
    """All conditions, each once; a restriction without a type may not read the message."""
    texts = {
        (text, restriction.type) for restriction in restrictions for text in restriction.conditions
    }
    return tuple(
        compile_condition(None if kind is None else layout, text)
        for text, kind in sorted(texts, key=repr)
    )


def needed_keys(restrictions: Iterable[Restriction]) -> frozenset[str]:
    """The names of the filter keys that a guard for `restrictions` needs."""
    return frozenset().union(*(key_names(restriction.filters) for restriction in restrictions))


def _stages(restrictions: Iterable[Restriction]) -> list[_Stage]:
    """As few passes as possible: rules for the same field must be in separate passes.

    Every pass can only remove information, so the order of the passes affects the form of the
    result, but never makes it reveal more than a single pass would.
    """
    stages: list[_Stage] = []
    for restriction in restrictions:
        _add_to_stages(stages, {rule.path: rule for rule in restriction.filters})
    return [stage for stage in stages if stage]


def _add_to_stages(stages: list[_Stage], rules: _Stage) -> None:
    """Add to the last stage if no other rule there overlaps, else to a new one."""
    if stages and all(
        stages[-1].get(path) == rule or not any(_overlap(path, other) for other in stages[-1])
        for path, rule in rules.items()
    ):
        stages[-1].update(rules)
    else:
        stages.append(dict(rules))


def _overlap(one: str, other: str) -> bool:
    """Whether the paths are equal or one contains the other (`a` contains `a[*].b`)."""
    steps, others = (path.replace("[*]", ".*").split(".") for path in (one, other))
    shared = min(len(steps), len(others))
    return steps[:shared] == others[:shared]
