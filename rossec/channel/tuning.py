"""The sizes, in bytes, at which the sending path changes its way. Each was measured (`python -m bench
channel`).

None of them is a limit of the protocol: those are beside what they limit. Changing one changes speed alone.
"""

from typing import Final

# -- from messages to units

BATCH: Final = 256 * 1024
"""Messages that wait for one subscriber are sent as one unit up to here: batching amortizes system calls,
beyond this a unit only adds latency."""
JOIN_UNITS_BELOW: Final = 32 * 1024
"""Units of a burst that are shorter are joined in one record: copying them beats a record of their own."""
JOINED_UNITS: Final = 64 * 1024
"""So much of a burst is joined: one record of `ONE_RECORD`, sealed at once."""

# -- from units to records

ONE_RECORD: Final = 64 * 1024
"""A unit up to here is sealed by one call, without the generator of records."""
JOIN_PIECES_BELOW: Final = 16 * 1024
"""Pieces of a unit that are shorter are copied together; a larger one is cut into views, never copied."""
ENCRYPT_INTO_FROM: Final = 4 * 1024
"""From here on encrypting in place beats one more copy of the ciphertext."""
REUSE_BUFFER_ABOVE: Final = 64 * 1024
"""Records of a longer unit share one buffer: a new one for each costs a sixth of the encryption, for zeroing
it."""
RECORDS_AT_ONCE: Final = 4
"""So many whole records are in that buffer, written by one system call; beyond a megabyte nothing is
gained."""

# -- from records to the kernel

HIGH_WATER: Final = 64 * 1024
"""Above so many bytes that the kernel did not take a writer waits."""
UNSENT: Final = 16 * 1024
"""Above so many bytes that the kernel has not sent yet it takes no more for a receiver that asked for the
newest message only: its own buffer would hold seconds of a slow line."""
