"""The restrictions for one receiver: expiry, conditions, limits, filters, in this order.

Those of narrowings come after, layer by layer. Conditions that read no message are checked first, whoever
wrote them. A guard is built once per connection and fails closed: what it cannot process is not sent.
"""

from collections.abc import Callable, Hashable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any, Final, NamedTuple, TypeAlias
from weakref import WeakValueDictionary

from grants.conditions import Condition, compile_condition
from grants.decision import Decision
from grants.errors import GrantError, GrantExpired, MessageRefused
from grants.filters.coarsening import (
    BodyFields,
    CommonState,
    FieldKey,
    Group,
    HysteresisState,
    frame_reader,
    group_of,
)
from grants.filters.compile import Filter, compile_filter
from grants.filters.hashing import Keys, is_personal, key_names, receiver_keys
from grants.filters.layout import Buffer, Layout
from grants.limits import RateBucket, SlotGate
from grants.model import KEY_SIZE, FilterRule, Restriction, Right, format_time

MAX_MEMORIES: Final = 16_384  # about 700 bytes each
_MAX_RATES: Final = 64  # of one memory, and as many slots; a grant has one

MakeLock: TypeAlias = Callable[[], AbstractContextManager[Any]]
_CommonKey: TypeAlias = tuple[tuple[str, ...], Right, Group]
_MemoryKey: TypeAlias = tuple[tuple[str, ...], bytes, Right, str]


class Memory:
    """The state of one key, one right and one name.

    `lock` is held around `take` and the use of any other state; `find_common` finds what is common to the
    keys of a group.
    """

    def __init__(
        self,
        lock: AbstractContextManager[Any] | None = None,
        find_common: Callable[[Group], CommonState] | None = None,
    ) -> None:
        self._find_common = find_common or (lambda _: CommonState())
        self.lock: Final = nullcontext() if lock is None else lock
        self._buckets: dict[float, RateBucket] = {}
        self._gates: dict[int, SlotGate] = {}
        self._commons: dict[Group, CommonState] = {}

    def bucket(self, rate: float) -> RateBucket:
        """The bucket for a rate; a new one starts with no more tokens than the others have."""
        with self.lock:
            if rate not in self._buckets:
                _check_limit(len(self._buckets), _MAX_RATES, "rates")
                left = max((other.tokens for other in self._buckets.values()), default=rate + 1)
                self._buckets[rate] = RateBucket(rate, left)
            return self._buckets[rate]

    def gate(self, seconds: int) -> SlotGate:
        """The gate for slots of so many seconds."""
        with self.lock:
            if seconds not in self._gates:
                _check_limit(len(self._gates), _MAX_RATES, "slots")
                self._gates[seconds] = SlotGate(seconds)
            return self._gates[seconds]

    def is_longest(self, gate: SlotGate, now: float) -> bool:
        """Whether no longer slot of the key is in use.

        The moments of slots of many lengths together tell more than those of the longest, and who
        narrows a right can make as many as it likes.
        """
        longer = (each for seconds, each in self._gates.items() if seconds > gate.seconds)
        return not any(each.is_in_use(now) for each in longer)

    def common(self, group: Group) -> CommonState:
        """What is common to a group; without a store, to this key alone."""
        with self.lock:
            if group not in self._commons:
                _check_limit(len(self._commons), _MAX_RATES, "bodies")
                self._commons[group] = self._find_common(group)
            return self._commons[group]

    def take(self, bucket: RateBucket, message_id: object, now: float) -> bool:
        """Whether the message with this id is admitted at `now`; all rates of the key count it.

        So two grants with rates, presented on two connections, admit no more messages than the
        higher of the two alone.
        """
        if bucket.last_message is message_id:
            return True
        for each in self._buckets.values():
            each.refill(now)
        if bucket.left < bucket.interval:
            return False
        for each in self._buckets.values():
            each.charge(message_id)
        return True

    def is_fresh(self, now: float) -> bool:
        """Whether it equals a new memory."""
        with self.lock:
            full = all(each.is_full(now) for each in self._buckets.values())
            unused = all(each.is_fresh(now) for each in self._gates.values())
            return full and unused


class MemoryStore:
    """All memories of one process, `limit` at most.

    Only state that equals fresh state and is not in use is evicted, so eviction gains a peer nothing;
    otherwise a new peer is refused. `clock` is that of the guards; `lock` makes the locks, if threads share
    the store.
    """

    def __init__(
        self, clock: Callable[[], float], lock: MakeLock = nullcontext, limit: int = MAX_MEMORIES
    ) -> None:
        self._clock = clock
        self._make_lock = lock
        self._limit = limit
        self._lock = lock()
        self._stored: dict[_MemoryKey, Memory] = {}
        self._in_use: WeakValueDictionary[_MemoryKey, Memory] = WeakValueDictionary()
        self._commons: dict[_CommonKey, CommonState] = {}
        self._evicted_at = -1

    def find(self, scope: tuple[str, ...], decision: Decision) -> Memory:
        """The memory for the key, right and name of `decision` within `scope`."""
        # The state belongs to a key, a right and a name, never to a connection: a peer that reconnects, opens
        # a hundred connections, or hands a right on, gets no more by it. A chain's first holder comes first,
        # so that a grant of the last one's own beside it opens no other account.
        chains = [grant for grant in decision.grants if grant.chain]
        holder = min(grant.links[0].holder for grant in chains or decision.grants)
        key = (scope, holder, decision.right, decision.name)
        with self._lock:
            found = self._stored.get(key)
            if found is None:
                now = self._clock()
                if len(self._stored) >= self._limit and int(now) != self._evicted_at:
                    # Once a second: a peer that asks again and again makes no more than one search of all.
                    self._evicted_at = int(now)
                    for each in [each for each, item in self._stored.items() if item.is_fresh(now)]:
                        del self._stored[each]
                    # Memories that connections still use must stay stored: they will change again.
                    self._stored.update(self._in_use.items())
                _check_limit(len(self._stored), self._limit, "limited rights")
                common = partial(self._common, scope, decision.right)
                found = self._stored[key] = self._in_use[key] = Memory(self._make_lock(), common)
            return found

    def _common(self, scope: tuple[str, ...], right: Right, group: Group) -> CommonState:
        key = scope, right, group
        with self._lock:
            found = self._commons.get(key)
            if found is None:
                if len(self._commons) >= self._limit:
                    for each in [each for each, item in self._commons.items() if item.is_fresh]:
                        del self._commons[each]
                _check_limit(len(self._commons), self._limit, "topics with hysteresis")
                found = self._commons[key] = CommonState(self._make_lock())
            return found

    def __len__(self) -> int:
        return len(self._stored)


@dataclass(frozen=True)
class MemoryScope:
    """Finds the memory of a decision for one node, and for one part of its state."""

    store: MemoryStore
    scope: tuple[str, ...]

    def __call__(self, decision: Decision) -> Memory:
        return self.store.find(self.scope, decision)

    def child(self, part: str) -> "MemoryScope":
        return replace(self, scope=(*self.scope, part))


def _check_limit(count: int, limit: int, what: str) -> None:
    if count >= limit:
        raise GrantError(
            f"{limit} {what} are stored already, and none can be evicted yet",
            "wait until the rates of other peers have recovered, or restart this node",
        )


class _Layer(NamedTuple):
    conditions: tuple[Condition, ...] = ()
    filters: tuple[Filter, ...] = ()


class Guard:
    """Applies restrictions to serialized messages of one type for one receiver.

    `layout` may be None only if no restriction reads the messages. `keys` are the publisher's for `hash`,
    by name (`needed_keys`). `find_memory` finds the state of the holder's earlier connections; without it
    the guard starts with fresh state, which is for trials only. Guards with the same `key` have the same
    result for every message: apply once, send to all. Expiry is not part of it: call `check` for every
    receiver.
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
        fields = layout.root.fields if layout is not None else ()
        self._frame = frame_reader(has_header=bool(fields) and fields[0][1].name == "std_msgs/Header")
        ordered = sorted(decision.restrictions, key=lambda each: each.layer)
        blind = _compile_conditions(None, (each for each in ordered if each.type is None))
        holder = decision.grants[0].holder if decision.grants else bytes(KEY_SIZE)
        own = receiver_keys(keys or {}, holder)
        layers: list[_Layer] = []
        before = 0  # passes of the layers before, so that each pass has a state of hysteresis of its own
        for _, group in groupby(ordered, key=lambda each: each.layer):
            here = tuple(group)
            filters: list[Filter] = []
            if layout is not None:
                for number, stage in enumerate(_stages(here), before):
                    state = partial(self._hysteresis, number)
                    filters.append(compile_filter(layout, stage.values(), own, state))
            before += len(filters)
            typed = _compile_conditions(layout, (each for each in here if each.type is not None))
            layers.append(_Layer(typed, tuple(filters)))
        first, *later = layers or [_Layer()]
        self._conditions = (*blind, *first.conditions)
        self._layers = (first._replace(conditions=()), *later)
        rates = [each.rate for each in ordered if each.rate is not None]
        slots = [each.slot for each in ordered if each.slot is not None]
        self._bucket = self._require_memory().bucket(min(rates)) if rates else None
        if self._group[0]:
            self._require_common()
        self._slot = max(slots, default=0)
        self._gate = self._require_memory().gate(self._slot) if slots else None
        shape = layout.digest if layout is not None else None
        personal = any(is_personal(restriction.filters) for restriction in decision.restrictions)
        # A pseudonym `per: receiver` is of one key, so its result is never shared with another's.
        self.key: Hashable = (self.memory, shape, decision.restrictions, holder if personal else None)
        # Each step of `_apply` is a restriction's; without any they do nothing, for 1 us.
        self._passes_all = not decision.restrictions

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

    def check(self, now: float) -> None:
        """Return if the right still holds at `now`."""
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

        Limits count fractions of `now`. `message_id` is the same object for the same message on all
        connections of the holder, so that the rate counts it once; None: a new message.
        """
        if self._passes_all:
            return [message]
        try:
            return self._apply(message, now, object() if message_id is None else message_id)
        except GrantError:
            raise
        except Exception as error:
            # Fail closed on programming errors too: an exception never lets a message through.
            raise MessageRefused(f"applying restrictions failed: {type(error).__name__}") from error

    def __call__(self, message: Buffer, now: float) -> list[Buffer] | None:
        """`check`, then `apply`."""
        self.check(now)
        return self.apply(message, now)

    def _apply(  # noqa: PLR0911 - the steps of the spec, each of which may withhold the message
        self, message: Buffer, now: float, message_id: object
    ) -> list[Buffer] | None:
        # Section 4 of docs/spec/grant.md, "For each receiver and each message"; expiry is `check`.
        # 1. All conditions of entries without a type and of the first layer; they see whole seconds.
        whole = int(now)
        if not all(condition(message, whole) is True for condition in self._conditions):
            return None
        if self.memory is None:
            return self._filter(message, whole)
        with self.memory.lock:
            # 2. The slot, of a body its frame, and the rate. A token is taken last: a message that is
            # withheld for anything else must not cost one.
            memory, gate = self.memory, self._gate
            if gate is not None and not (gate.note(message_id, now) and memory.is_longest(gate, now)):
                return None
            if self._body is not None:
                common = self._require_common()
                with common.lock:
                    if not common.leads(self._frame(message), now, self._slot):
                        return None
            if self._bucket is not None and not memory.take(self._bucket, message_id, now):
                return None
            if gate is not None:
                gate.charge(message_id)
            # 3. The filters of the first layer, then of each further one its conditions and its filters.
            if self._common is None:
                return self._filter(message, whole)
            with self._common.lock:
                if self._body is None:
                    return self._filter(message, whole)
                frame = self._frame(message)
                self._body.load(frame)
                pieces = self._filter(message, whole)
                self._body.store(frame)
                return pieces

    def _filter(self, message: Buffer, now: int) -> list[Buffer] | None:
        # A layer's conditions see what the filters before it left: else whoever may narrow its right could
        # ask, by conditions of its own, what the filters hide from it.
        pieces: list[Buffer] = [message]
        for layer in self._layers:
            for condition in layer.conditions:
                pieces = [_joined(pieces)]
                if condition(pieces[0], now) is not True:
                    return None
            for rewrite in layer.filters:
                pieces = rewrite(_joined(pieces))
        return pieces


def check_type(name: str, restriction: Restriction) -> None:
    """Return if `restriction` may be applied to messages of the type `name`."""
    if restriction.type not in (None, name):
        raise GrantError(
            f"the grant is restricted for messages of type {restriction.type}, these are {name}",
            "ask for a grant for this message type",
        )


def _joined(pieces: list[Buffer]) -> Buffer:
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def _compile_conditions(layout: Layout | None, restrictions: Iterable[Restriction]) -> tuple[Condition, ...]:
    # All conditions, each once; a restriction without a type may not read the message.
    texts = {(text, restriction.type) for restriction in restrictions for text in restriction.conditions}
    return tuple(
        compile_condition(None if kind is None else layout, text) for text, kind in sorted(texts, key=repr)
    )


def needed_keys(restrictions: Iterable[Restriction]) -> frozenset[str]:
    """The names of the filter keys that a guard for `restrictions` needs."""
    return frozenset().union(*(key_names(restriction.filters) for restriction in restrictions))


def _stages(restrictions: Iterable[Restriction]) -> list[dict[str, FilterRule]]:
    # As few passes as possible: rules for the same field must be in separate passes.
    # Every pass can only remove information, so the order of the passes affects the form of the result, but
    # never makes it reveal more than a single pass would.
    stages: list[dict[str, FilterRule]] = [{}]
    for restriction in restrictions:
        last, rules = stages[-1], {rule.path: rule for rule in restriction.filters}
        if all(
            last.get(path) == rule or not any(_overlap(path, other) for other in last)
            for path, rule in rules.items()
        ):
            last.update(rules)
        else:
            stages.append(rules)
    return [stage for stage in stages if stage]


def _overlap(one: str, other: str) -> bool:
    steps, others = (path.replace("[*]", ".*").split(".") for path in (one, other))
    shared = min(len(steps), len(others))
    return steps[:shared] == others[:shared]
