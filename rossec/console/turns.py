"""How many questions of one source wait for the authority's service before a login. Pure.

Anybody on the network may ask for a challenge, and all such questions take turns at the service. A
source that has several waiting is told to come back, so a phone waits for few of each.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rossec.errors import HttpRefused
from rossec.net.halfopen import source_of

MAX_WAITING: Final = 4


class Turns:
    """The questions that wait, by their source: of IPv6 by the network."""

    def __init__(self) -> None:
        self._waiting: Counter[str] = Counter()

    @contextmanager
    def wait(self, address: str) -> Iterator[None]:
        """Count one more while the body runs; empty: a proxy's, where all have no address.

        Raises:
            HttpRefused: so many of this source wait.
        """
        source = source_of(address)
        if address and self._waiting[source] >= MAX_WAITING:
            raise HttpRefused("too many attempts", "wait a minute", status=429)
        self._waiting[source] += 1
        try:
            yield
        finally:
            self._waiting[source] -= 1
            if not self._waiting[source]:
                del self._waiting[source]
