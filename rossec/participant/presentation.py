"""How many tokens are shown at once: what a peer that has not judged them yet may be sent.

Pure. A chain of narrowings may be as large as a few dozen grants, so the bytes count as well as
the number; what has no room is left out, or comes with the next call.
"""

from collections.abc import Iterable, Iterator
from typing import Final

from rossec.participant.token_opening import MAX_GRANTS, MAX_PRESENTED

MAX_CALL: Final = 64  # tokens; the master stores this many of one node
MAX_CALL_BYTES: Final = 512 * 1024  # a body has 1 MiB, and base64 takes a third more
_ARRAY_HEAD, _BYTES_HEAD = 3, 5  # at most, in CBOR


def fitting(tokens: Iterable[bytes]) -> Iterator[bytes]:
    """The first of the tokens that a field of a connection header has room for."""
    room, left = MAX_PRESENTED - _ARRAY_HEAD, MAX_GRANTS
    for token in tokens:
        size = len(token) + _BYTES_HEAD
        if left and size <= room:
            room, left = room - size, left - 1
            yield token


def batches(tokens: Iterable[bytes]) -> Iterator[list[bytes]]:
    """The tokens in calls to the master: each at most `MAX_CALL` of them and `MAX_CALL_BYTES`."""
    batch: list[bytes] = []
    size = 0
    for token in tokens:
        if batch and (len(batch) == MAX_CALL or size + len(token) > MAX_CALL_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(token)
        size += len(token)
    if batch:
        yield batch
