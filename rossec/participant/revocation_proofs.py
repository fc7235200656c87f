"""Asking the master for proofs, where revocations are a tree and not a list.

As with `rossec.participant.grant_renewal`, `prove` is for asyncio and `prove_blocking` for threads:
call either every second or so, and when a new connection to the master finds its identity unproved.
"""

import logging
from typing import Final, Protocol

from ca.errors import RevocationRefused
from rossec.errors import AnswerMalformed
from rossec.participant.grant_renewal import MasterCall

METHOD: Final = "rossec.revocationProofs"
MAX_PER_CALL: Final = 64  # entries in one call: what the master takes

_log = logging.getLogger("rossec.node")


class Provable(Protocol):
    """`ca.revocation.state.Revocations`, or what keeps threads apart before one."""

    @property
    def unproved(self) -> list[bytes]:
        """Entries that wait for a proof."""

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """Take a proof. Raises `RevocationRefused`."""


async def prove(call: MasterCall, revocations: Provable) -> int:
    """Have proved what is wanted; returns how many entries were.

    Raises:
        RossecError: the master refuses, answers nonsense, or is out of reach.
    """
    wanted = revocations.unproved[:MAX_PER_CALL]
    return take(revocations, wanted, await call(METHOD, wanted)) if wanted else 0


def take(revocations: Provable, wanted: list[bytes], answer: object) -> int:
    """Take the proofs in `answer`, one for each entry in `wanted`, or none at all.

    Raises:
        AnswerMalformed: it is no such list.
    """
    if not isinstance(answer, list) or len(answer) not in {0, len(wanted)}:
        raise AnswerMalformed("the master sent another number of proofs than were asked for")
    return sum(_take(revocations, *pair) for pair in zip(wanted, answer, strict=False))


def _take(revocations: Provable, entry: bytes, proof: object) -> bool:
    try:
        revocations.add_proof(entry, proof if isinstance(proof, bytes) else b"")
    except RevocationRefused as error:
        _log.warning("the master proves nothing of %s: %s", entry.hex(), error)
        return False
    return True
