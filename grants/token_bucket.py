"""A token bucket: `rate` tokens a second, and at most `capacity` at once. Pure.

The clock is the caller's, in seconds since any beginning, but always the same one.
"""


class TokenBucket:
    """Full at first, unless `tokens` says otherwise; the caller takes from `tokens`."""

    __slots__ = ("_rate", "_refilled_at", "capacity", "tokens")

    def __init__(self, rate: float, capacity: float, tokens: float | None = None) -> None:
        self.capacity = capacity
        self.tokens = capacity if tokens is None else min(tokens, capacity)
        self._rate = rate
        self._refilled_at: float | None = None

    def refill(self, now: float) -> float:
        """Add the tokens since the last refill; how many there are. A clock set back adds none."""
        if self._refilled_at is not None and now > self._refilled_at:
            self.tokens = min(self.tokens + (now - self._refilled_at) * self._rate, self.capacity)
        self._refilled_at = now
        return self.tokens
