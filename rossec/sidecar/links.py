"""The live connections of one identity, and why each may go on.

A shell. A link is known to the watch before the first byte of data passes: a revocation that
arrives meanwhile finds it.
"""

import contextlib
import logging
from collections.abc import Iterator

from ca.certificates import Identity
from grants.decision import Decision
from rossec.errors import RossecError
from rossec.net.stream import SecureStream

_log = logging.getLogger("rossec.sidecar")


class Link:
    """A connection that `decision` admitted; the watch cuts it when that ends."""

    def __init__(self, stream: SecureStream[Identity], decision: Decision) -> None:
        self.stream = stream
        self.decision = decision
        self.ends = min(decision.expires, stream.peer.not_after)


class Links:
    """Those of one identity."""

    def __init__(self) -> None:
        self._links: set[Link] = set()

    def __iter__(self) -> Iterator[Link]:
        return iter(tuple(self._links))

    @contextlib.contextmanager
    def linked(self, stream: SecureStream[Identity], decision: Decision) -> Iterator[None]:
        """A link while the block runs; a connection that ends meanwhile ends the block alone."""
        link = Link(stream, decision)
        self._links.add(link)
        try:
            yield
        except* RossecError as group:
            _log.info("the connection with %s ended: %s", stream.peer.name, group.exceptions[0])
        finally:
            self._links.discard(link)

    def abort(self, reason: str) -> None:
        """Cut them all."""
        for link in self:
            link.stream.abort(reason)
