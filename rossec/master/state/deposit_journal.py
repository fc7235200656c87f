"""The journal of deposited grants, from which a restarted master restores them. Pure.

The content of a record (`journal_records`) is one letter and what it is about: `G` and a grant as
signed, which was deposited; `H` and the id of a grant, which its holder has presented. What has
expired or is revoked needs no record: it is left out when the journal is read.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from rossec.master.state import journal_records

MAGIC: Final = b"rossec deposits 1\n"
ID_SIZE: Final = 16
_GRANT: Final = b"G"
_HELD: Final = b"H"


class GrantDeposited(NamedTuple):
    """The grant `data`, as signed, was deposited."""

    data: bytes


class GrantHeld(NamedTuple):
    """The holder of the deposited grant `grant_id` has presented it."""

    grant_id: bytes


DepositChange = GrantDeposited | GrantHeld


def encode(change: DepositChange) -> bytes:
    """One record."""
    match change:
        case GrantDeposited(data):
            return journal_records.frame(_GRANT + data)
        case GrantHeld(grant_id):
            return journal_records.frame(_HELD + grant_id)


def decode(data: bytes) -> tuple[list[DepositChange], int]:
    """The changes in a journal, and the length of its undamaged part."""
    changes: list[DepositChange] = []
    valid = len(MAGIC) if data.startswith(MAGIC) else 0
    if valid:
        for change, end in _records(data, valid):
            changes.append(change)
            valid = end
    return changes, valid


def _records(data: bytes, at: int) -> Iterator[tuple[DepositChange, int]]:
    for content, end in journal_records.contents(data, at):
        letter, rest = content[:1], content[1:]
        if letter == _GRANT and rest:
            yield GrantDeposited(rest), end
        elif letter == _HELD and len(rest) == ID_SIZE:
            yield GrantHeld(rest), end
        else:
            return
