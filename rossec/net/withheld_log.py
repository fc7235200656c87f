"""Log lines about messages and calls that are withheld: one for each cause and peer in a minute.

A peer with a limited grant decides how many of its messages are malformed or not allowed, and must
not fill the disk of the node that applies the limit. The next line has the count of those left out.
"""

import logging
from threading import Lock
from typing import Final

from ca.errors import HintedError
from rossec.log_limits import CAUSE, LogRateLimit

SENT: Final = "%(where)s: withheld from %(peer)s: %(cause)s"
RECEIVED: Final = "%(where)s: withheld a message of %(peer)s: %(cause)s"
REFUSED: Final = "%(where)s: refused %(peer)s: %(cause)s"
UNREACHED: Final = "%(where)s: not connected to %(peer)s: %(cause)s%(hint)s"
RATE_LIMIT: Final = LogRateLimit()
_LOCK: Final = Lock()  # rospy's connections have threads


def warn(log: logging.Logger, text: str, where: str, peer: str, cause: object) -> None:
    """Log `text`, filled in with the place, the peer and the cause, unless it is rate-limited.

    Args:
        cause: an error counts by its type, since its text may be the peer's.
    """
    if not log.isEnabledFor(logging.WARNING):
        return
    kind = type(cause).__name__ if isinstance(cause, Exception) else cause
    hint = f" ({cause.hint})" if isinstance(cause, HintedError) and cause.hint else ""
    args = {"where": where, "peer": peer, "cause": cause, "hint": hint}
    record = log.makeRecord(log.name, logging.WARNING, "", 0, text, (args,), None)
    setattr(record, CAUSE, (f"{log.name} {where} {peer} {kind}", peer))
    with _LOCK:
        allowed = RATE_LIMIT.filter(record)
    if allowed:
        log.handle(record)
