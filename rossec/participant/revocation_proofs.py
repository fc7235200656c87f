"""Requests for proofs to the master, where revocations are a tree and not a list.

Call `prove` about every second, and when the master's own identity has no proof yet.
"""

import logging
from typing import Final, Protocol

from ca.errors import RevocationRefused
from rossec.errors import AnswerMalformed
from rossec.participant.grant_renewal import MasterCall

METHOD: Final = "rossec.revocationProofs"
MAX_PER_CALL: Final = 64  # entries in one call: the limit of the master

_log = logging.getLogger("rossec.node")


class Provable(Protocol):
    """`Access`, or an object that locks it."""

    @property
    def unproved(self) -> list[bytes]:
        """Entries that wait for a proof."""

    def add_proof(self, entry: bytes, proof: bytes) -> None:
        """Take a proof. Raises `RevocationRefused`."""


async def prove(call: MasterCall, revocations: Provable) -> int:
    """Request the proofs that are wanted; returns how many were accepted.

    Raises:
        RossecError: the master refuses, sends a malformed answer, or is out of reach.
    """
    wanted = revocations.unproved[:MAX_PER_CALL]
    return take(revocations, wanted, await call(METHOD, wanted)) if wanted else 0


def take(revocations: Provable, wanted: list[bytes], answer: object) -> int:
    """Take the proofs in `answer`, one for each entry in `wanted`, or none at all.

    Raises:
        AnswerMalformed: it is not such a list.
    """
    if not isinstance(answer, list) or len(answer) not in {0, len(wanted)}:
        raise AnswerMalformed("the master's answer has a different number of proofs than requested")
    return sum(_take(revocations, *pair) for pair in zip(wanted, answer, strict=False))


def _take(revocations: Provable, entry: bytes, proof: object) -> bool:
    try:
        revocations.add_proof(entry, proof if isinstance(proof, bytes) else b"")
    except RevocationRefused as error:
        _log.warning("the master's proof for %s is invalid: %s", entry.hex(), error)
        return False
    return True
