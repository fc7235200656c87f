"""What is said of messages and calls that are withheld: a line for each cause and peer in a minute.

Whoever has a limited right decides how many of his messages are malformed or not allowed, and must
not fill the disk of those who apply the limit. How many were left out stands in the next line.
"""

import logging
from threading import Lock
from typing import Final

from rossec.log_limits import CAUSE, LogRateLimit

SENT: Final = "%(where)s: withheld from %(peer)s: %(cause)s"
RECEIVED: Final = "%(where)s: withheld a message of %(peer)s: %(cause)s"
REFUSED: Final = "%(where)s: refused %(peer)s: %(cause)s"
_RATE_LIMIT: Final = LogRateLimit()
_LOCK: Final = Lock()  # rospy's connections have threads


def warn(log: logging.Logger, text: str, where: str, peer: str, cause: object) -> None:
    """Write `text`, filled in with the place, the peer and the cause, unless it was said already.

    Args:
        cause: an error counts by its type, since its text may be in the peer's hand.
    """
    if not log.isEnabledFor(logging.WARNING):
        return
    kind = type(cause).__name__ if isinstance(cause, Exception) else cause
    args = {"where": where, "peer": peer, "cause": cause}
    record = log.makeRecord(log.name, logging.WARNING, "", 0, text, (args,), None)
    setattr(record, CAUSE, (f"{log.name} {where} {peer} {kind}", peer))
    with _LOCK:
        said = _RATE_LIMIT.filter(record)
    if said:
        log.handle(record)
