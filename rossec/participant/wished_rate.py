"""Messages thinned out to a rate that their receiver wished. Pure.

Not the rate of a grant, which is a limit and belongs to the holder's key (`grants.memory`): this
one belongs to a connection and only ever takes away. Which messages it takes away does not depend
on their content.
"""

from typing import Final

from grants.token_bucket import TokenBucket

_AT_ONCE: Final = 2.0
"""With room for one alone, a message that comes a moment early would cost a whole interval."""


class WishedRate:
    """Admits `rate` messages a second on average, and never more than two at once."""

    def __init__(self, rate: float) -> None:
        self._bucket = TokenBucket(rate, _AT_ONCE)

    def admits(self, now: float) -> bool:
        """Whether the message that is there at `now` is sent; seconds, of a clock never set."""
        if self._bucket.refill(now) < 1:
            return False
        self._bucket.tokens -= 1
        return True
