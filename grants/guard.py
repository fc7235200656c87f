"""What stands between a publisher and one receiver: expiry, conditions, rate, filters, in order.

Built once per connection from the layout the wire proved and the decision; then called for every
message. It fails closed: what it does not understand is not sent.
"""

from collections.abc import Hashable, Iterable
from typing import Final, TypeAlias

from grants.codegen import Buffer
from grants.conditions import Condition, compile_condition
from grants.decision import Decision
from grants.errors import GrantError, GrantExpired, MessageRefused, RestrictionMismatch
from grants.filters import Filter, compile_filter
from grants.hashing import Keys, key_names
from grants.layout import Layout
from grants.model import FilterRule, Restriction
from grants.validity import moment


class Guard:
    """Treats serialized messages of one type for one receiver.

    Args:
        layout: of the messages; may be None only if no restriction looks into them.
        decision: from `authorize`.
        keys: the publisher's keys for `hash`, 32 bytes each, by name (see `needed_keys`).

    Raises:
        RestrictionMismatch: a restriction is written for another message type.
        ConditionRefused, FilterRefused: a restriction does not fit the layout, or a key is missing.
    """

    def __init__(self, layout: Layout | None, decision: Decision, keys: Keys | None = None) -> None:
        for restriction in decision.restrictions:
            _check_type(layout, restriction)
        self.expires: Final = decision.expires
        self._conditions = _conditions(layout, decision.restrictions)
        self._filters = _filters(layout, decision.restrictions, keys or {})
        self._bucket = _bucket(decision.restrictions)
        self._key = (layout.type_name, layout.md5) if layout is not None else None
        self._restrictions = decision.restrictions

    @property
    def key(self) -> Hashable:
        """Equal for guards that treat every message alike: treat once, send to all of them.

        A guard with a memory (a rate, a hysteresis) equals only itself. Expiry is not part of
        it: call `check` for every receiver.
        """
        if self._bucket is not None or any(rewrite.remembers for rewrite in self._filters):
            return self
        return (self._key, self._restrictions)

    def check(self, now: int) -> None:
        """Return if the right still holds at `now`.

        Raises:
            GrantExpired: it does not.
        """
        if now >= self.expires:
            raise GrantExpired(
                f"the grant expired at {moment(self.expires)}", "ask the authority to renew it"
            )

    def treat(self, message: Buffer, now: int) -> list[Buffer] | None:
        """Return `message` in pieces as the receiver may see it, or None if it may not.

        Raises:
            MessageRefused: the message does not have its type's layout, or anything unforeseen.
        """
        try:
            return self._treat(message, now)
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
        return self.treat(message, now)

    def _treat(self, message: Buffer, now: int) -> list[Buffer] | None:
        for condition in self._conditions:
            if condition(message, now) is not True:
                return None
        if self._bucket is not None and not self._bucket.take(now):
            return None
        pieces: list[Buffer] = [message]
        for rewrite in self._filters:
            pieces = rewrite(pieces[0] if len(pieces) == 1 else b"".join(pieces))
        return pieces


_Stage: TypeAlias = dict[str, FilterRule]


def _check_type(layout: Layout | None, restriction: Restriction) -> None:
    if restriction.type is None:
        return
    if layout is None or layout.type_name != restriction.type:
        found = layout.type_name if layout is not None else "unknown"
        raise RestrictionMismatch(
            f"the grant is restricted for messages of type {restriction.type}, these are {found}",
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


class _Bucket:
    """A token bucket: over any time, `rate` messages a second and `max(1, rate)` more at most."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._most = max(1.0, rate)
        self._tokens = self._most
        self._at: int | None = None

    def take(self, now: int) -> bool:
        """Whether one more message may pass at `now`; a clock set back brings nothing."""
        if self._at is not None and now > self._at:
            self._tokens = min(self._tokens + (now - self._at) * self._rate, self._most)
        self._at = now
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


def _bucket(restrictions: Iterable[Restriction]) -> _Bucket | None:
    """The tightest of the rates: what it lets through, the others do too."""
    rates = [restriction.rate for restriction in restrictions if restriction.rate is not None]
    return _Bucket(min(rates)) if rates else None


def needed_keys(restrictions: Iterable[Restriction]) -> frozenset[str]:
    """The names of the filter keys a guard for `restrictions` must be given."""
    return frozenset().union(*(key_names(restriction.filters) for restriction in restrictions))


def _filters(
    layout: Layout | None, restrictions: Iterable[Restriction], keys: Keys
) -> tuple[Filter, ...]:
    """As few passes as possible: rules for the same fields must come one after another.

    Every pass can only take information away, so the order of the passes decides the form of
    the result, never that it reveals more than a single pass would.
    """
    if layout is None:
        return ()
    stages: list[_Stage] = []
    for restriction in restrictions:
        _place(stages, {rule.path: rule for rule in restriction.filters})
    return tuple(compile_filter(layout, stage.values(), keys) for stage in stages if stage)


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
